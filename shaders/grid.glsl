// The sparse voxel grid: an indirection grid of macroblocks, and the atlas that holds the occupied ones.
//
// Source: SNeRG paper, section 5.1. The atlas is laid out anew when it is uploaded (viewer/rendering/gpu_scene.py).
// Inputs: indirection: per macroblock the atlas block (x, y, z) and, in a, 1 where it is empty; with an empty macroblock
//   added on every side, so that a sample that rounding puts outside of the grid needs no test.
//   atlas_rgba, atlas_features: trilinear, filtered in floating point; the paper's marcher has atlas_alpha, atlas_rgb instead.
//   atlas_slots: macroblocks of the atlas along x, y, z.
// Options: SLOT_WIDTH: voxels in x from one atlas block to the next; twice the others' where features lie beside.
//   FEATURES_BESIDE: features are in atlas_rgba, PADDED_BLOCK_SIZE voxels further in x.
//   ATLAS_TEXEL, INDIRECTION_TEXEL: 1 / size of these textures. Constants, and nearest texels by textureLod: Mesa
//   22.3 gathers each lane's copy of a uniform anew in every turn of a loop, and each lane's mipmap level in a texelFetch.
// A macroblock's padded copy begins one voxel before its data, so a point `local` of its data, [0, BLOCK_SIZE]^3, is
// at atlas_block * SLOT_SIZE + 1 + local in the atlas, and a trilinear fetch there stays in the copy.

uniform usampler3D indirection;
uniform vec3 atlas_slots;
#if MARCHER == MARCHER_PAPER
uniform sampler3D atlas_alpha;
uniform sampler3D atlas_rgb;
#else
uniform sampler3D atlas_rgba;
#endif
#ifndef FEATURES_BESIDE
uniform sampler3D atlas_features;
#endif

const vec3 SLOT_SIZE = vec3(SLOT_WIDTH, PADDED_BLOCK_SIZE, PADDED_BLOCK_SIZE);

const float INVERSE_BLOCK_SIZE = 1.0 / float(BLOCK_SIZE);

struct Content {
    vec4 rgba;      // premultiplied
    bool occupied;  // whether the macroblock holds anything
    vec3 coordinates;  // in the atlas: features are fetched only where a sample contributes
};

// The macroblock that a point belongs to.
vec3 block_of(vec3 position) {
    return floor(position * INVERSE_BLOCK_SIZE);
}

// Where a macroblock's content is: atlas block in xyz, a = 0; or a = 1 for none.
uvec4 indirection_of(vec3 block) {
    return textureLod(indirection, (1.0 + block + 0.5) * INDIRECTION_TEXEL, 0.0);
}

// Texture coordinates of a point in the atlas.
vec3 atlas_coordinates(uvec4 entry, vec3 local) {
    return (vec3(entry.xyz) * SLOT_SIZE + 1.0 + local) * ATLAS_TEXEL;
}

vec4 fetch_rgba(vec3 coordinates) {
#if MARCHER == MARCHER_PAPER
    vec4 rgba;
    rgba.a = textureLod(atlas_alpha, coordinates, 0.0).r;  // first: llvmpipe takes a tenth longer the other way round
    rgba.rgb = textureLod(atlas_rgb, coordinates, 0.0).rgb;
    return rgba;
#else
    return textureLod(atlas_rgba, coordinates, 0.0);
#endif
}

// What lies at a point of the grid, in macroblock `block`.
Content content_at(vec3 position, vec3 block) {
    uvec4 entry = indirection_of(block);
    vec3 coordinates = atlas_coordinates(entry, position - block * float(BLOCK_SIZE));
    return Content(fetch_rgba(coordinates), entry.a == 0u, coordinates);
}

// What lies at a point of the padded copy, [0, B]^3, of a slot.
Content content_of_slot(float order, vec3 padded) {
    float row = floor((order + 0.5) / atlas_slots.x);
    float layer = floor((row + 0.5) / atlas_slots.y);
    vec3 slot = vec3(order - row * atlas_slots.x, row - layer * atlas_slots.y, layer);
    vec3 coordinates = (slot * SLOT_SIZE + clamp(padded, 0.5, float(PADDED_BLOCK_SIZE) - 0.5)) * ATLAS_TEXEL;
    return Content(fetch_rgba(coordinates), true, coordinates);
}

vec4 features_of(Content content) {
#ifdef FEATURES_BESIDE
    vec3 aside = vec3(float(PADDED_BLOCK_SIZE) * ATLAS_TEXEL.x, 0.0, 0.0);
    return textureLod(atlas_rgba, content.coordinates + aside, 0.0);
#elif defined(FEATURES_STORED)
    return textureLod(atlas_features, content.coordinates, 0.0);
#else
    return vec4(0.0);
#endif
}
