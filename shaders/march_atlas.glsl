// The atlas itself, as a block of macroblocks in the order they lie in memory, with their padding and their edges drawn.
//
// Source: the published viewer's "3D texture atlas" view. The repacked atlas is a narrow beam (viewer/rendering/gpu_scene.py), so
// its slots are stacked anew, x first, then y, then z, into a cube of atlas_side^3 cells that fills the grid's box.
// Inputs: atlas_count: how many hold content; atlas_side; atlas_min, atlas_max: that box, of contracted packs the inner cube.
// Every sample is taken, one a voxel of the atlas.

uniform float atlas_count;
uniform float atlas_side;
uniform vec3 atlas_min;
uniform vec3 atlas_max;

#define EDGE_VOXELS 0.7
#define EDGE_OPACITY 0.12

// Whether a point of a cell is on one of its twelve edges: near the faces of two axes at least.
bool on_edge(vec3 local) {
    vec3 near = vec3(lessThan(min(local, float(PADDED_BLOCK_SIZE) - local), vec3(EDGE_VOXELS)));
    return dot(near, vec3(1.0)) >= 2.0;
}

void march(Ray ray, inout Marched marched) {
    float cube = atlas_side * float(PADDED_BLOCK_SIZE);
    vec3 size = atlas_max - atlas_min;
    float scale = cube / min(min(size.x, size.y), size.z);  // atlas voxels a voxel of the grid
    vec3 origin = (ray.origin - 0.5 * (atlas_min + atlas_max)) * scale + 0.5 * cube;
    vec2 inside = box_interval(origin, ray.inverse, vec3(0.0), vec3(cube));
    float end = min(inside.y, ray.length * scale);
    for (float t = max(inside.x, 0.0) + 0.5; t < end; t += 1.0) {
        vec3 position = origin + t * ray.direction;
        vec3 cell = min(floor(position / float(PADDED_BLOCK_SIZE)), atlas_side - 1.0);
        float order = cell.x + atlas_side * (cell.y + atlas_side * cell.z);
        if (order >= atlas_count) continue;
        vec3 local = position - cell * float(PADDED_BLOCK_SIZE);
        Content content = content_of_slot(order, local);
        if (on_edge(local)) content.rgba = mix(content.rgba, vec4(0.25, 0.45, 0.7, 1.0), EDGE_OPACITY);
        if (content.rgba.a > ALPHA_CONTRIBUTES) {
            composite(marched, content, t, position, cell, ray.viewdir);
            if (marched.transmittance <= TRANSMITTANCE_STOP) break;
        }
    }
}
