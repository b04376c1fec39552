// Two pictures subtracted: |a - b| times a gain, for comparing a view with a photograph or with another pack.
//
// Inputs: picture_a, picture_b; where each lies, box (x0, y0, x1, y1 in 0 ... 1 of the target, from its top left), and
//   which part of its texture that is, part (u, v at the top left and at the bottom right); target_size in pixels; gain.
// Outside of either box nothing is compared, and a dimmed picture_a is shown.
#version 330 core

uniform sampler2D picture_a;
uniform sampler2D picture_b;
uniform vec4 box_a;
uniform vec4 box_b;
uniform vec4 part_a;
uniform vec4 part_b;
uniform vec2 target_size;
uniform float gain;

out vec4 fragment_colour;

vec3 colour(sampler2D picture, vec4 box, vec4 part, vec2 at) {
    return texture(picture, mix(part.xy, part.zw, (at - box.xy) / (box.zw - box.xy))).rgb;
}

bool within(vec4 box, vec2 at) {
    return all(greaterThanEqual(at, box.xy)) && all(lessThanEqual(at, box.zw));
}

void main() {
    vec2 at = gl_FragCoord.xy / target_size;
    at.y = 1.0 - at.y;
    vec3 a = colour(picture_a, box_a, part_a, at);
    bool both = within(box_a, at) && within(box_b, at);
    vec3 b = colour(picture_b, box_b, part_b, at);
    fragment_colour = vec4(both ? min(gain * abs(a - b), 1.0) : 0.15 * a, 1.0);
}
