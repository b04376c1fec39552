// What is shown of a marched ray: the picture itself, or one of its ingredients.
//
// Source: docs/rendering.md ("Shading") for the picture; the published viewer and three.js for the choice of views.
// Options: MODE: MODE_NORMAL the picture; MODE_DIFFUSE without the view-dependent residual; MODE_FEATURES the first three
//   features; MODE_VIEW_DEPENDENT the residual alone; MODE_ALPHA opacity; MODE_DEPTH mean depth, near bright;
//   MODE_SAMPLES and MODE_JUMPS what the pixel cost; MODE_MACROBLOCKS a colour for each macroblock first hit;
//   MODE_ATLAS the atlas as it lies in memory, see march_atlas.glsl.
// Inputs: background; depth_range: distances shown white and black; cost_scale: the count shown brightest.

#include "colour_map.glsl"

uniform vec3 background;
uniform vec2 depth_range;
uniform float cost_scale;

vec3 diffuse_colour(Marched marched) {
    return marched.rgb + marched.transmittance * background;
}

// The view-dependent colour to add; zero where the ray met next to nothing.
vec3 residual(Ray ray, Marched marched) {
#if defined(VIEW_MLP) && !defined(VIEW_MLP_PER_SAMPLE)
    if (marched.transmittance <= TRANSMITTANCE_SHADED)
        return view_residual(ray.viewdir, diffuse_colour(marched), marched.features);
#endif
    return vec3(0.0);
}

vec3 displayed_colour(Ray ray, Marched marched) {
    float alpha = 1.0 - marched.transmittance;
#if MODE == MODE_NORMAL
    return diffuse_colour(marched) + residual(ray, marched);
#elif MODE == MODE_DIFFUSE || MODE == MODE_ATLAS
    return diffuse_colour(marched);
#elif MODE == MODE_FEATURES
    return marched.features.rgb;
#elif MODE == MODE_VIEW_DEPENDENT
    return residual(ray, marched);
#elif MODE == MODE_ALPHA
    return vec3(alpha);
#elif MODE == MODE_DEPTH
    float mean = marched.depth / max(alpha, 1e-6);
    return vec3(alpha * (depth_range.y - mean) / (depth_range.y - depth_range.x));
#elif MODE == MODE_SAMPLES
    return colour_map(marched.fetched / cost_scale);
#elif MODE == MODE_JUMPS
    return colour_map(marched.jumps / cost_scale);
#elif MODE == MODE_MACROBLOCKS
    return mix(background, block_colour(marched.block) * (0.35 + 0.65 * marched.rgb), alpha);
#endif
}
