// Nothing but depth is written: see content_hull.vert.
#version 330 core

void main() {}
