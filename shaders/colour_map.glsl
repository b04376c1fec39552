// False colours: a heat map for counts, and a stable colour for each macroblock.
//
// Source: the heat map runs black, blue, magenta, orange, white, like matplotlib's "inferno", in four linear pieces.

vec3 colour_map(float x) {
    x = 4.0 * clamp(x, 0.0, 1.0);
    vec3 colour = mix(vec3(0.0), vec3(0.25, 0.05, 0.45), min(x, 1.0));
    colour = mix(colour, vec3(0.75, 0.2, 0.35), clamp(x - 1.0, 0.0, 1.0));
    colour = mix(colour, vec3(0.98, 0.6, 0.1), clamp(x - 2.0, 0.0, 1.0));
    return mix(colour, vec3(1.0, 1.0, 0.85), clamp(x - 3.0, 0.0, 1.0));
}

// Neighbouring macroblocks get hues that differ by steps of the golden ratio.
vec3 block_colour(vec3 block) {
    float hue = fract(dot(block, vec3(0.6180340, 0.3819660, 0.2360680) + vec3(0.0, 0.21, 0.47)));
    return clamp(abs(fract(hue + vec3(0.0, 2.0, 1.0) / 3.0) * 6.0 - 3.0) - 1.0, 0.0, 1.0) * 0.75 + 0.25;
}
