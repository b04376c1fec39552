// What is seen behind a scene instead of its plain background: a gradient from top to bottom, or a checkerboard.
//
// It is put there by opacity after all shading (docs/rendering.md, "Backdrops"): the view MLP is always given the plain background.
// Inputs: intrinsics, viewport_origin, picture_size (ray.glsl); backdrop_height: pixels of the whole picture, of which this may be
//   a tile; backdrop_first, backdrop_second: above and below, or of the squares.
// Options: BACKDROP_CHECKER: defined for the checkerboard.

#define SQUARES 40.0  // from the top of a picture to its bottom

uniform float backdrop_height;
uniform vec3 backdrop_first;
uniform vec3 backdrop_second;

vec3 backdrop(vec2 fragment) {
    vec2 pixel = fragment - viewport_origin;
    pixel.y = picture_size.y - pixel.y;
    vec2 place = (pixel - intrinsics.zw) / backdrop_height;  // y from -0.5 above to 0.5 below
#ifdef BACKDROP_CHECKER
    vec2 square = floor(place * SQUARES);
    return mod(square.x + square.y, 2.0) < 0.5 ? backdrop_first : backdrop_second;
#else
    return mix(backdrop_first, backdrop_second, clamp(place.y + 0.5, 0.0, 1.0));
#endif
}
