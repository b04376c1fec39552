// The atlas itself, as a block of macroblocks in the order they lie in memory, with their padding and their edges drawn.
//
// Source: the published viewer's "3D texture atlas" view. The repacked atlas is a narrow beam (viewer/rendering/gpu_scene.py), so
// its slots are stacked anew, x first, then y, then z, into a cube of atlas_side^3 cells that fills the grid's box.
// Inputs: atlas_slots: macroblocks of the atlas along x, y, z; atlas_count: how many hold content; atlas_side.
// Every sample is taken, one a voxel of the atlas.

uniform vec3 atlas_slots;
uniform float atlas_count;
uniform float atlas_side;
uniform vec3 grid_size;

#define EDGE_VOXELS 0.7
#define EDGE_OPACITY 0.12

vec4 atlas_content(vec3 coordinates) {
#if MARCHER == MARCHER_PAPER
    return vec4(textureLod(atlas_rgb, coordinates, 0.0).rgb, textureLod(atlas_alpha, coordinates, 0.0).r);
#else
    return textureLod(atlas_rgba, coordinates, 0.0);
#endif
}

// Whether a point of a cell is on one of its twelve edges: near the faces of two axes at least.
bool on_edge(vec3 local) {
    vec3 near = vec3(lessThan(min(local, float(PADDED_BLOCK_SIZE) - local), vec3(EDGE_VOXELS)));
    return dot(near, vec3(1.0)) >= 2.0;
}

Marched march(Ray ray) {
    Marched marched = nothing_yet();
    float cube = atlas_side * float(PADDED_BLOCK_SIZE);
    float scale = cube / min(min(grid_size.x, grid_size.y), grid_size.z);  // atlas voxels a voxel of the grid
    vec3 origin = (ray.origin - 0.5 * grid_size) * scale + 0.5 * cube;
    vec2 inside = box_interval(origin, ray.inverse, vec3(0.0), vec3(cube));
    float end = min(inside.y, ray.length * scale);
    for (float t = max(inside.x, 0.0) + 0.5; t < end; t += 1.0) {
        vec3 position = origin + t * ray.direction;
        vec3 cell = min(floor(position / float(PADDED_BLOCK_SIZE)), atlas_side - 1.0);
        float order = cell.x + atlas_side * (cell.y + atlas_side * cell.z);
        if (order >= atlas_count) continue;
        vec3 local = position - cell * float(PADDED_BLOCK_SIZE);
        float row = floor((order + 0.5) / atlas_slots.x);
        float layer = floor((row + 0.5) / atlas_slots.y);
        vec3 slot = vec3(order - row * atlas_slots.x, row - layer * atlas_slots.y, layer);
        vec3 texel = slot * SLOT_SIZE + clamp(local, 0.5, float(PADDED_BLOCK_SIZE) - 0.5);
        vec4 rgba = atlas_content(texel * atlas_texel);
        if (on_edge(local)) rgba = mix(rgba, vec4(0.25, 0.45, 0.7, 1.0), EDGE_OPACITY);
        if (rgba.a > ALPHA_CONTRIBUTES) {
            composite(marched, rgba, texel * atlas_texel, t, cell, ray.viewdir);
            if (marched.transmittance <= TRANSMITTANCE_STOP) break;
        }
    }
    return marched;
}
