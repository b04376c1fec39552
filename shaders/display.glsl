// What is shown of a marched ray: the picture itself, or one of its ingredients.
//
// Source: docs/rendering.md ("Shading") for the picture; the published viewer and three.js for the choice of views.
// Options: MODE: MODE_NORMAL the picture; MODE_DIFFUSE without the view-dependent residual; MODE_FEATURES the first three
//   features; MODE_VIEW_DEPENDENT the residual alone; MODE_ALPHA opacity; MODE_DEPTH mean depth, near bright;
//   MODE_NORMALS the direction that surfaces face in the grid frame, -1 ... 1 along x, y, z as red, green, blue of 0 ... 1;
//   MODE_SAMPLES and MODE_JUMPS what the pixel cost; MODE_MACROBLOCKS a colour for each macroblock first hit;
//   MODE_ATLAS the atlas as it lies in memory, see march_atlas.glsl.
// RAW: numbers for files instead of a colour: see raw_values.
// Inputs: background; depth_range: distances shown white and black; cost_scale: the count shown brightest.

#ifdef LOOK
#include "look.glsl"
#endif

uniform vec3 background;
uniform vec2 depth_range;
uniform float cost_scale;
#if defined(NDC) && MODE == MODE_NORMALS
uniform mat3 training_R_grid;  // lengths kept
#endif

// False colours of counts, in four linear pieces between COLOUR_STOP_0 and COLOUR_STOP_4 (viewer/rendering/renderer.py).
vec3 colour_map(float x) {
    x = 4.0 * clamp(x, 0.0, 1.0);
    vec3 colour = mix(COLOUR_STOP_0, COLOUR_STOP_1, min(x, 1.0));
    colour = mix(colour, COLOUR_STOP_2, clamp(x - 1.0, 0.0, 1.0));
    colour = mix(colour, COLOUR_STOP_3, clamp(x - 2.0, 0.0, 1.0));
    return mix(colour, COLOUR_STOP_4, clamp(x - 3.0, 0.0, 1.0));
}

// A stable colour for each macroblock; neighbours get hues that differ by steps of the golden ratio.
vec3 block_colour(vec3 block) {
    float hue = fract(dot(block, vec3(0.6180340, 0.3819660, 0.2360680) + vec3(0.0, 0.21, 0.47)));
    return clamp(abs(fract(hue + vec3(0.0, 2.0, 1.0) / 3.0) * 6.0 - 3.0) - 1.0, 0.0, 1.0) * 0.75 + 0.25;
}

vec3 diffuse_colour(Marched marched) {
    return marched.rgb + marched.transmittance * background;
}

// The view-dependent colour to add; zero where the ray met next to nothing.
vec3 residual(Ray ray, Marched marched) {
#if defined(VIEW_MLP) && !defined(VIEW_MLP_PER_SAMPLE)
    if (marched.transmittance <= TRANSMITTANCE_SHADED)
        return view_residual(ray.viewdir, diffuse_colour(marched), marched.features);
#endif
    return vec3(0.0);
}

#if MODE == MODE_DEPTH || MODE == MODE_NORMALS
// Mean distance along the ray, in voxels; in contracted packs, in voxels of space.
float mean_depth(Ray ray, Marched marched) {
    float mean = marched.depth / max(1.0 - marched.transmittance, 1e-6);
#ifdef CONTRACTED
    return ray.start + distance_at(ray, mean);
#else
    return mean;
#endif
}

// Where the ray meets the scene, at its mean depth: in voxels; in forward-facing packs in the training frame, unwarped.
vec3 mean_point(Ray ray, Marched marched) {
    vec3 position = ray.origin + (mean_depth(ray, marched) - ray.start) * ray.direction;
#ifdef NDC
    vec3 warped = inverse(voxel_R_ndc) * (position - voxel_t_ndc);
    float z = 2.0 * NDC_NEAR / min(warped.z - 1.0, -TINY);
    return vec3(-warped.xy * z / ndc_scale, z);
#else
    return position;
#endif
}
#endif

#if MODE == MODE_NORMALS
// The sum of T a n in the grid frame. Normals go through the warp as gradients do: by the transpose of its derivative.
vec3 grid_normal(Ray ray, Marched marched) {
#ifdef NDC
    vec3 p = mean_point(ray, marched);
    vec3 fall = transpose(voxel_R_ndc) * marched.normal;
    vec2 across = -fall.xy * ndc_scale / p.z;
    vec3 unwarped = vec3(across, -dot(across, p.xy) / p.z - 2.0 * NDC_NEAR * fall.z / (p.z * p.z));
    return length(marched.normal) * transpose(training_R_grid) * unwarped / max(length(unwarped), TINY);
#else
    return marched.normal;
#endif
}
#endif

vec3 displayed_colour(Ray ray, Marched marched) {
    float alpha = 1.0 - marched.transmittance;
#if MODE == MODE_NORMAL || MODE == MODE_DIFFUSE || MODE == MODE_ATLAS
    vec3 colour = diffuse_colour(marched) + residual(ray, marched);
#ifdef LOOK
    colour = with_look(colour, marched.transmittance * background, alpha);
#endif
    return colour;
#elif MODE == MODE_FEATURES
    return marched.features.rgb;
#elif MODE == MODE_VIEW_DEPENDENT
    return residual(ray, marched);
#elif MODE == MODE_ALPHA
    return vec3(alpha);
#elif MODE == MODE_DEPTH
    return vec3(alpha * (depth_range.y - mean_depth(ray, marched)) / (depth_range.y - depth_range.x));
#elif MODE == MODE_NORMALS
    return 0.5 * (alpha + grid_normal(ray, marched));
#elif MODE == MODE_SAMPLES
    return colour_map(marched.fetched / cost_scale);
#elif MODE == MODE_JUMPS
    return colour_map(marched.jumps / cost_scale);
#elif MODE == MODE_MACROBLOCKS
    return mix(background, block_colour(marched.block) * (0.35 + 0.65 * marched.rgb), alpha);
#endif
}

#ifdef RAW
// What mean values of rays are made of, with opacity as the fourth: depth: the opacity times mean_point; normals: times the
// unit normal, in the grid frame; samples and jumps: the numbers of both, and opacity; all else: the colour times opacity, nothing
// of the background in it.
vec4 raw_values(Ray ray, Marched marched) {
    float alpha = 1.0 - marched.transmittance;
#if MODE == MODE_DEPTH
    return vec4(alpha * mean_point(ray, marched), alpha);
#elif MODE == MODE_NORMALS
    return vec4(grid_normal(ray, marched), alpha);
#elif MODE == MODE_SAMPLES || MODE == MODE_JUMPS
    return vec4(marched.fetched, marched.jumps, alpha, alpha);
#elif OVER_BACKGROUND
    vec3 shown = clamp(displayed_colour(ray, marched), 0.0, 1.0);
    return vec4(clamp(shown - marched.transmittance * background, 0.0, alpha), alpha);
#else
    return vec4(displayed_colour(ray, marched), alpha);
#endif
}
#endif
