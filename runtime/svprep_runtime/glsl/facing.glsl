// The uploaded decision which side of each face the light is on: 1, -1, or 0 for edge-on.
layout(std430, binding = 3) readonly buffer Facing { uint facing[]; };  // int8, four a word

int facing_of(uint face) {
    return int(facing[face >> 2u] << (24u - 8u * (face & 3u))) >> 24;
}
