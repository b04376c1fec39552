// A sparse neural radiance grid, one ray a pixel.
//
// Source: Hedman et al., "Baking Neural Radiance Fields for Real-Time View Synthesis" (SNeRG), sections 5.1 and 5.2.
// Options (defined by viewer/rendering/shader_source.py, as numbers unless said otherwise):
//   MARCHER          MARCHER_EXACT, MARCHER_PAPER or MARCHER_BRUTE
//   MODE             one of MODE_...; see display.glsl
//   NDC              defined for forward-facing packs
//   DISTORTION       defined for cameras whose lens distorts
//   FEATURES_STORED  defined where the pack has features; FEATURES_BESIDE where they lie beside rgba in one atlas
//   VIEW_MLP         defined where the pack has a view MLP and the mode asks for it
//   VIEW_MLP_PER_SAMPLE  ablation: the view MLP at every sample instead of once a pixel (paper, table 1, row 3)
//   RAW_COUNTS       defined to write samples fetched, steps over empty space and opacity instead of a colour
//   BLOCK_SIZE, PADDED_BLOCK_SIZE, SLOT_WIDTH  data voxels per macroblock side, B, and atlas voxels to the next in x
// Every length below is in voxels and every position in the grid, [0, grid size], unless said otherwise.
#version 330 core
#ifdef BRICKS
#extension GL_ARB_shading_language_420pack : require
#endif

#include "constants"
#include "ray.glsl"
#include "grid.glsl"
#include "composite.glsl"
#if MODE == MODE_ATLAS
#include "march_atlas.glsl"
#elif MARCHER == MARCHER_EXACT
#include "march_exact.glsl"
#elif MARCHER == MARCHER_PAPER
#include "march_paper.glsl"
#else
#include "march_brute.glsl"
#endif
#include "display.glsl"

out vec4 fragment_colour;

void main() {
    Ray ray = camera_ray(gl_FragCoord.xy);
    Marched marched = march(ray);
#ifdef NDC
    partially_unpremultiply(marched);
#endif
#ifdef RAW_COUNTS
    fragment_colour = vec4(marched.fetched, marched.jumps, 1.0 - marched.transmittance, 1.0);
#else
    fragment_colour = vec4(clamp(displayed_colour(ray, marched), 0.0, 1.0), 1.0);
#endif
}
