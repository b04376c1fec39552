// One triangle that covers the viewport, behind the hull of content_hull.vert; needs no vertex buffer.
#version 330 core

void main() {
    vec2 corner = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
    gl_Position = vec4(2.0 * corner - 1.0, 0.5, 1.0);
}
