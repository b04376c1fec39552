// The view MLP with its weights as constants: vector arithmetic only, which compilers fold and schedule freely.
//
// Source: SNeRG paper, section 4 and appendix A; inputs in the order of docs/rendering.md, "Shading": the view direction v,
// sin(2^i v), sin(2^i v + pi / 2) for i = 0 .. 3, colour, features; 34 -> 16 -> 16 -> 3, ReLU, ReLU, sigmoid.
// The include "view_mlp_weights" is generated from the pack (viewer/rendering/shader_source.py). It holds
//   vec4 layer_0_J(v, s1, s2, s4, s8, c1, c2, c4, c8, rgb, features), vec4 layer_1_J(h0, h1, h2, h3) for J = 0 .. 3,
//   and vec3 layer_2_0(h0, h1, h2, h3): weights times inputs plus bias, of the outputs 4 J .. 4 J + 3.
// Only one sine and one cosine are taken: sin 2x = 2 sin x cos x, cos 2x = 1 - 2 sin^2 x.

#include "view_mlp_weights"

#define RELU(x) max(x, vec4(0.0))

// The view-dependent residual of a ray, or of a sample where the ablation asks for it. v: unit, training frame.
vec3 view_residual(vec3 v, vec3 rgb, vec4 features) {
    vec3 s1 = sin(v), c1 = cos(v);
    vec3 s2 = 2.0 * s1 * c1, c2 = 1.0 - 2.0 * s1 * s1;
    vec3 s4 = 2.0 * s2 * c2, c4 = 1.0 - 2.0 * s2 * s2;
    vec3 s8 = 2.0 * s4 * c4, c8 = 1.0 - 2.0 * s4 * s4;
    vec4 a0 = RELU(layer_0_0(v, s1, s2, s4, s8, c1, c2, c4, c8, rgb, features));
    vec4 a1 = RELU(layer_0_1(v, s1, s2, s4, s8, c1, c2, c4, c8, rgb, features));
    vec4 a2 = RELU(layer_0_2(v, s1, s2, s4, s8, c1, c2, c4, c8, rgb, features));
    vec4 a3 = RELU(layer_0_3(v, s1, s2, s4, s8, c1, c2, c4, c8, rgb, features));
    vec4 b0 = RELU(layer_1_0(a0, a1, a2, a3));
    vec4 b1 = RELU(layer_1_1(a0, a1, a2, a3));
    vec4 b2 = RELU(layer_1_2(a0, a1, a2, a3));
    vec4 b3 = RELU(layer_1_3(a0, a1, a2, a3));
    return 1.0 / (1.0 + exp(-layer_2_0(b0, b1, b2, b3)));
}
