// Front-to-back compositing of samples (docs/rendering.md, "Compositing"; SNeRG paper, section 5.2 and appendix C.3).
//
// Content is premultiplied: with the sample's colour c, features f and opacity a, and transmittance T so far,
//   C += T c,   F += T f,   T *= 1 - a     where a > ALPHA_CONTRIBUTES, until T <= TRANSMITTANCE_STOP.
// Options: ACCUMULATE_FEATURES; ACCUMULATE_NORMAL, which the mode normals needs. What else a mode does not show, compilers leave out.
// NORMAL_REACH: half the side, in voxels, of the cube at the middles of whose edges opacity is compared for the normal; less is
//   rougher, more blunts edges.
#define NORMAL_REACH 1.0

struct Marched {
    vec3 rgb;             // C
    vec4 features;        // F
    float transmittance;  // T
    float depth;          // sum of T a t
    vec3 normal;          // sum of T a n, n the unit vector along which opacity falls most, in voxels
    float fetched;        // samples fetched from the atlas
    float jumps;          // steps over empty space
    vec3 block;           // macroblock of the first sample that contributed, or -1
};

Marched nothing_yet() {
    return Marched(vec3(0.0), vec4(0.0), 1.0, 0.0, vec3(0.0), 0.0, 0.0, vec3(-1.0));
}

#ifdef VIEW_MLP
#if MARCHER == MARCHER_PAPER
#include "view_mlp_textures.glsl"
#else
#include "view_mlp.glsl"
#endif
#endif

#ifdef CONTRACTED
uniform vec3 contraction_centre;   // the middle of the inner cube, voxels ...
uniform float contraction_radius;  // ... and half its side

// The unit vector through that side of the cube [-1, 1]^3 beyond which a point lies; zero in the cube.
vec3 outward_at(vec3 point) {
    vec3 size = abs(point);
    float largest = max(max(size.x, size.y), size.z);
    if (largest <= 1.0) return vec3(0.0);
    vec3 side = size.x == largest ? vec3(1.0, 0.0, 0.0) : size.y == largest ? vec3(0.0, 1.0, 0.0) : vec3(0.0, 0.0, 1.0);
    return side * sign(point);
}
#endif

#ifdef ACCUMULATE_NORMAL
uniform vec3 grid_size;

#ifdef CONTRACTED
// A gradient at a point of contracted space as that of space there, up to its length: times the transpose of du/dx.
// In the pyramid of space beyond a side of the cube, with the outward unit vector e and w: times w, it is
//   g where g and e are at right angles, and along e, (e g) / w - (u g without e).
vec3 gradient_in_space(vec3 gradient, vec3 position) {
    vec3 u = (position - contraction_centre) / contraction_radius;
    vec3 outward = outward_at(u);
    if (outward == vec3(0.0)) return gradient;
    vec3 along = outward * dot(outward, gradient);
    vec3 across = gradient - along;
    return across + along * (2.0 - dot(outward, u)) - outward * dot(u, across);
}
#endif

float opacity_at(vec3 position) {
    vec3 inside = clamp(position, vec3(0.0), grid_size - 1e-3);
    Content content = content_at(inside, block_of(inside));
    return content.occupied ? content.rgba.a : 0.0;
}

// The unit vector along which opacity falls most; zero where it does not. At a plane of any direction it is 2 degrees off on
// average (7 where opacity is 0 or 1); from the middles of the cube's faces it would be 8 (12), from its corners 6 (10).
vec3 normal_at(vec3 position) {
    vec3 rise = vec3(0.0);
    for (int axis = 0; axis < 3; axis++)
        for (int edge = 0; edge < 4; edge++) {
            vec3 away = vec3(0.0);
            away[axis] = float(edge & 1) * 2.0 - 1.0;
            away[(axis + 1) % 3] = float(edge >> 1) * 2.0 - 1.0;
            rise += away * opacity_at(position + NORMAL_REACH * away);
        }
    float steepness = length(rise);
#ifdef CONTRACTED
    rise = gradient_in_space(rise, position);
    rise *= steepness / max(length(rise), TINY);
#endif
    return -rise / max(steepness, 1e-4);
}
#endif

// Adds one sample that contributes, at `position` (voxels). t: its distance along the ray.
void composite(inout Marched marched, Content content, float t, vec3 position, vec3 block, vec3 viewdir) {
    vec4 rgba = content.rgba;
#ifdef VIEW_MLP_PER_SAMPLE
    vec4 features = features_of(content) / rgba.a;
    rgba.rgb += rgba.a * view_residual(viewdir, rgba.rgb / rgba.a, features);
#elif defined(ACCUMULATE_FEATURES)
    marched.features += marched.transmittance * features_of(content);
#endif
    marched.rgb += marched.transmittance * rgba.rgb;
    marched.depth += marched.transmittance * rgba.a * t;
#ifdef ACCUMULATE_NORMAL
    marched.normal += marched.transmittance * rgba.a * normal_at(position);
#endif
    marched.block = marched.block.x < 0.0 ? block : marched.block;
    marched.transmittance *= 1.0 - rgba.a;
}

// Baking forward-facing scenes loses some opacity; this gives it back (appendix C.3).
void partially_unpremultiply(inout Marched marched) {
    float alpha = 1.0 - marched.transmittance;
    if (alpha > 0.0) {
        float saturated = min(1.0, UNPREMULTIPLY_GAIN * alpha);
        marched.rgb *= saturated / alpha;
        marched.features *= saturated / alpha;
        marched.depth *= saturated / alpha;
        marched.normal *= saturated / alpha;
        marched.transmittance = 1.0 - saturated;
    }
}
