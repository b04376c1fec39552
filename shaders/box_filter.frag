// The mean of SAMPLES x SAMPLES rays a pixel: the last step of viewer/rendering/supersampling.py.
//
// Inputs: rays: a picture of SAMPLES times the pixels along each side, float, its lower left corner at texel (0, 0);
//   corner: pixel of the target that this texel belongs to;
//   count: rays of a pixel in all, where others are added.
// The sum is of what the marchers' shader displays, before anything is rounded to 8 bits.
#version 330 core

uniform sampler2D rays;
uniform vec2 corner;
uniform float count;

out vec4 fragment_colour;

void main() {
    ivec2 first = ivec2(gl_FragCoord.xy - corner) * SAMPLES;
    vec4 sum = vec4(0.0);
    for (int y = 0; y < SAMPLES; ++y)
        for (int x = 0; x < SAMPLES; ++x) sum += texelFetch(rays, first + ivec2(x, y), 0);
    fragment_colour = sum / count;
}
