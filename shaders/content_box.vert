// The box around all content as 12 triangles, so that only pixels whose ray meets it are shaded at all.
//
// Inputs: content_min, content_max (voxels); camera_R_grid, camera_position; intrinsics, picture_size (pixels, y down).
// Drawn as a strip of 14 vertices with front faces culled: the back faces are there from inside of the box, too. Depth
// is clamped, so that neither clipping plane matters. The box is grown by a voxel, more than rasterising could round.
#version 330 core

uniform vec3 content_min;
uniform vec3 content_max;
uniform mat3 camera_R_grid;
uniform vec3 camera_position;
uniform vec4 intrinsics;
uniform vec2 picture_size;

void main() {
    // A cube as one strip: each bit of the three numbers says which of the two sides a vertex is on.
    int bit = 1 << gl_VertexID;
    vec3 side = vec3((0x287a & bit) != 0, (0x02af & bit) != 0, (0x31e3 & bit) != 0);
    vec3 seen = camera_R_grid * (mix(content_min - 1.0, content_max + 1.0, side) - camera_position);
    vec2 pixel = vec2(1.0, -1.0) * intrinsics.xy * seen.xy + intrinsics.zw * -seen.z;  // times depth
    vec2 ndc = 2.0 * pixel / picture_size + seen.z;
    gl_Position = vec4(ndc.x, -ndc.y, 0.0, -seen.z);
}
