// Fills the picture with its backdrop where no ray is cast: see viewer/rendering/renderer.py.
#version 330 core

uniform vec2 viewport_origin;
uniform vec2 picture_size;
uniform vec4 intrinsics;

#include "backdrop.glsl"

out vec4 fragment_colour;

void main() {
    fragment_colour = vec4(backdrop(gl_FragCoord.xy), 1.0);
}
