// A sparse neural radiance grid, one ray a pixel.
//
// Source: Hedman et al., "Baking Neural Radiance Fields for Real-Time View Synthesis" (SNeRG), sections 5.1 and 5.2.
// Options (defined by viewer/rendering/shader_source.py, as numbers unless said otherwise):
//   MARCHER          MARCHER_EXACT, MARCHER_PAPER or MARCHER_BRUTE
//   MODE             one of MODE_...; see display.glsl
//   NDC              defined for forward-facing packs
//   CONTRACTED       defined for contracted packs; see path.glsl
//   DISTORTION       defined for cameras whose lens distorts
//   ORTHOGRAPHIC     defined for cameras whose rays are parallel
//   FEATURES_STORED  defined where the pack has features; FEATURES_BESIDE where they lie beside rgba in one atlas
//   VIEW_MLP         defined where the pack has a view MLP and the mode asks for it
//   VIEW_MLP_PER_SAMPLE  ablation: the view MLP at every sample instead of once a pixel (paper, table 1, row 3)
//   RAW              defined to write numbers with opacity instead of a colour; see display.glsl
//   OVER_BACKGROUND  1 where the mode shows the background, else 0
//   BACKDROP         defined where something is seen behind the scene instead of the plain background; see backdrop.glsl
//   LOOK             defined where colours are shown with a look; see look.glsl
//   BLOCK_SIZE, PADDED_BLOCK_SIZE, SLOT_WIDTH  data voxels per macroblock side, B, and atlas voxels to the next in x
// Every length below is in voxels and every position in the grid, [0, grid size], unless said otherwise.
#version 330 core

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
#ifdef CONTRACTED
#include "path.glsl"
#endif
#include "display.glsl"
#ifdef BACKDROP
#include "backdrop.glsl"
#endif

out vec4 fragment_colour;

void main() {
    Ray ray = camera_ray(gl_FragCoord.xy);
    Marched marched = nothing_yet();
#ifdef CONTRACTED
    march_path(ray, marched);
#else
    march(ray, marched);
#endif
#ifdef NDC
    partially_unpremultiply(marched);
#endif
#ifdef RAW
    fragment_colour = raw_values(ray, marched);
#else
    vec3 shown = clamp(displayed_colour(ray, marched), 0.0, 1.0);
#ifdef BACKDROP
    shown = clamp(shown + marched.transmittance * (backdrop(gl_FragCoord.xy) - background), 0.0, 1.0);
#endif
    fragment_colour = vec4(shown, 1.0);
#endif
}
