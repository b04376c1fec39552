// The sparse voxel grid: an indirection grid of macroblocks, and the atlas that holds the occupied ones.
//
// Source: SNeRG paper, section 5.1. The atlas is repacked when it is uploaded (viewer/rendering/gpu_scene.py).
// Inputs: indirection: per macroblock the atlas block (x, y, z) and, in a, 1 where it is empty; with an empty macroblock
//   added on every side, so that a sample that rounding puts outside of the grid needs no test. atlas_texel: 1 / atlas size.
// Options: SLOT_WIDTH: voxels in x from one atlas block to the next; twice the others' where features lie beside.
// A macroblock's padded copy begins one voxel before its data, so a point `local` of its data, [0, BLOCK_SIZE]^3, is
// at atlas_block * SLOT_SIZE + 1 + local in the atlas, and a trilinear fetch there stays in the copy.

uniform usampler3D indirection;
uniform vec3 atlas_texel;

const vec3 SLOT_SIZE = vec3(SLOT_WIDTH, PADDED_BLOCK_SIZE, PADDED_BLOCK_SIZE);
const float INVERSE_BLOCK_SIZE = 1.0 / float(BLOCK_SIZE);

// The macroblock that a point belongs to.
vec3 block_of(vec3 position) {
    return floor(position * INVERSE_BLOCK_SIZE);
}

// Where its content is: atlas block in xyz, a = 0; or a = 1 for none.
uvec4 indirection_of(vec3 block) {
    return texelFetch(indirection, ivec3(block) + 1, 0);
}

// Texture coordinates of a point in the atlas.
vec3 atlas_coordinates(uvec4 entry, vec3 local) {
    return (vec3(entry.xyz) * SLOT_SIZE + 1.0 + local) * atlas_texel;
}
