// The faces of the scene.
layout(std430, binding = 0) readonly buffer Positions { float positions[]; };  // x y z, [m]
layout(std430, binding = 1) readonly buffer Corners { uint corners[]; };       // 3 a face

vec3 position_of(uint vertex) {
    return vec3(positions[3u * vertex], positions[3u * vertex + 1u], positions[3u * vertex + 2u]);
}

vec3 corner_of(uint face, uint k) {
    return position_of(corners[3u * face + k]);
}
