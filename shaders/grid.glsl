// The sparse voxel grid: an indirection grid of macroblocks, and the content of the occupied ones.
//
// Source: SNeRG paper, section 5.1. The content is laid out anew when it is uploaded (viewer/rendering/gpu_scene.py).
// Options: BRICKS: as bricks in buffers (grid_bricks.glsl), for software rasterisers; otherwise as an atlas that the card
//   filters (grid_filtered.glsl). Both give
//     Content content_at(vec3 position, vec3 block)        what lies at a point of the grid, in macroblock `block`
//     Content content_of_slot(float order, vec3 padded)    likewise at a point of the padded copy, [0, B]^3, of a slot
//     vec4 features_of(Content content)
//     int skip_word(ivec3 cell)                            of the skip grid, see march_exact.glsl
//   Content has rgba, premultiplied, and occupied: whether the macroblock holds anything.

const float INVERSE_BLOCK_SIZE = 1.0 / float(BLOCK_SIZE);

// The macroblock that a point belongs to.
vec3 block_of(vec3 position) {
    return floor(position * INVERSE_BLOCK_SIZE);
}

#ifdef BRICKS
#include "grid_bricks.glsl"
#else
#include "grid_filtered.glsl"
#endif
