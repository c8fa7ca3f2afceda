#version 450 core
// The scene from the light: orthographic, depth 0 at the near side of its box, 1 at the far.
layout(std430, binding = 0) readonly buffer Positions { float positions[]; };
layout(std430, binding = 1) readonly buffer Corners { uint corners[]; };
uniform mat4 map_from_world;

void main() {
    uint v = 3u * corners[gl_VertexID];
    gl_Position = map_from_world * vec4(positions[v], positions[v + 1u], positions[v + 2u], 1.0);
}
