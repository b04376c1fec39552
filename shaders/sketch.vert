// Triangles or points of an export, before it is written (scenepack/exports/scene.py).
//
// Inputs: place, normal (grid frame; a normal of zero: none), colour (sRGB); camera_R_grid, camera_position; intrinsics,
//   picture_size (pixels, y down); orthographic: 1 for parallel rays, else 0. depths: nearest and farthest that is shown;
//   point_size (grid units).
// Outputs: shade (sRGB).
// A lamp at the camera shows the shape; what has no normal is as bright everywhere.
#version 330 core

uniform mat3 camera_R_grid;
uniform vec3 camera_position;
uniform vec4 intrinsics;
uniform vec2 picture_size;
uniform vec2 depths;
uniform float orthographic;
uniform float point_size;

in vec3 place;
in vec3 normal;
in vec3 colour;
out vec3 shade;

const float AMBIENT = 0.35;

void main() {
    vec3 seen = camera_R_grid * (place - camera_position);
    float depth = mix(-seen.z, 1.0, orthographic);
    vec2 pixel = vec2(1.0, -1.0) * intrinsics.xy * seen.xy + intrinsics.zw * depth;  // times depth
    vec2 ndc = 2.0 * pixel / picture_size - depth;
    float parallel = (2.0 * -seen.z - depths.x - depths.y) / (depths.y - depths.x);
    gl_Position = vec4(ndc.x, -ndc.y, mix(depth - 2.0 * depths.x, parallel, orthographic), depth);
    gl_PointSize = clamp(point_size * intrinsics.y / max(depth, depths.x), 1.0, 32.0);
    vec3 to_camera = mix(-seen, vec3(0.0, 0.0, 1.0), orthographic);
    float facing = abs(dot(camera_R_grid * normal, normalize(to_camera)));
    shade = colour * (dot(normal, normal) > 0.0 ? mix(AMBIENT, 1.0, facing) : 1.0);
}
