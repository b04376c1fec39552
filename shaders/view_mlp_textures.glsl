// The view MLP as the paper runs it: nested loops over weight textures, a sine for each entry of the encoding.
//
// Source: SNeRG paper, appendix A: "simple nested for-loops", weights in 32-bit float textures, biases in the shader.
// The baseline; see view_mlp.glsl for the one that `exact` uses.
// Inputs: weights_L: float RGBA [inputs, outputs / 4], the weights from input y to the outputs 4 x .. 4 x + 3 of layer L.
// The include "view_mlp_biases" is generated from the pack: const vec4 BIAS_L[] for L = 0, 1, 2.

#include "view_mlp_biases"

uniform sampler2D weights_0;
uniform sampler2D weights_1;
uniform sampler2D weights_2;

vec3 view_residual(vec3 v, vec3 rgb, vec4 features) {
    float encoded[VIEW_INPUTS];
    for (int axis = 0; axis < 3; ++axis) encoded[axis] = v[axis];
    float frequency = 1.0;
    for (int i = 0; i < VIEW_FREQUENCIES; ++i) {
        for (int axis = 0; axis < 3; ++axis) {
            encoded[3 + 3 * i + axis] = sin(frequency * v[axis]);
            encoded[3 + 3 * (VIEW_FREQUENCIES + i) + axis] = sin(frequency * v[axis] + 0.5 * PI);
        }
        frequency *= 2.0;
    }
    for (int channel = 0; channel < 3; ++channel) encoded[VIEW_ENCODING + channel] = rgb[channel];
    for (int channel = 0; channel < FEATURES; ++channel) encoded[VIEW_ENCODING + 3 + channel] = features[channel];

    vec4 first[VIEW_HIDDEN / 4];
    for (int j = 0; j < VIEW_HIDDEN / 4; ++j) {
        first[j] = BIAS_0[j];
        for (int i = 0; i < VIEW_INPUTS; ++i) first[j] += encoded[i] * texelFetch(weights_0, ivec2(j, i), 0);
        first[j] = max(first[j], vec4(0.0));
    }
    vec4 second[VIEW_HIDDEN / 4];
    for (int j = 0; j < VIEW_HIDDEN / 4; ++j) {
        second[j] = BIAS_1[j];
        for (int i = 0; i < VIEW_HIDDEN; ++i) second[j] += first[i / 4][i % 4] * texelFetch(weights_1, ivec2(j, i), 0);
        second[j] = max(second[j], vec4(0.0));
    }
    vec4 third = BIAS_2[0];
    for (int i = 0; i < VIEW_HIDDEN; ++i) third += second[i / 4][i % 4] * texelFetch(weights_2, ivec2(0, i), 0);
    return 1.0 / (1.0 + exp(-third.rgb));
}
