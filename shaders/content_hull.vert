// The convex hull of all content, so that only pixels whose ray meets it are shaded at all.
//
// Inputs: corner (voxels; viewer/rendering/skip_grid.py); grid_R_camera, camera_position; intrinsics, picture_size (pixels, y down);
//   orthographic: 1 for parallel rays, else 0.
// Its back faces, which are there from inside of the hull, too, leave depth 0.5 where they are, and a triangle across the
// whole picture is shaded there alone (fullscreen.vert; a depth test comes before the shader). The hull itself is not
// shaded: a rasteriser does so in squares of pixels, which its many edges would share. Depth is clamped, so that neither
// clipping plane matters.
#version 330 core

uniform mat3 grid_R_camera;
uniform vec3 camera_position;
uniform vec4 intrinsics;
uniform vec2 picture_size;
uniform float orthographic;

in vec3 corner;

void main() {
    vec3 seen = inverse(grid_R_camera) * (corner - camera_position);
    float depth = mix(-seen.z, 1.0, orthographic);
    vec2 pixel = vec2(1.0, -1.0) * intrinsics.xy * seen.xy + intrinsics.zw * depth;  // times depth
    vec2 ndc = 2.0 * pixel / picture_size - depth;
    gl_Position = vec4(ndc.x, -ndc.y, 0.0, depth);
}
