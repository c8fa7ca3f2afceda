// Where a point lies on the screen: the one function that scene and volumes share.
// Depth is reversed and infinite: near_m / view depth, 1 at the near plane, 0 at infinity.
// `precise` and the fixed order of sums make equal points equal in every program.

#include "mesh.glsl"

uniform vec3 eye;
uniform vec3 row_right;    // scaled: the picture's edges are at -1 and 1
uniform vec3 row_up;
uniform vec3 row_forward;
uniform float near_m;
uniform vec2 jitter;       // of the sample within its pixel, in clip units

// p.w = 1: a point. p.w = 0: the point at infinity in the direction p.xyz.
vec4 clip_from_world(vec4 p) {
    precise vec3 v = p.xyz - eye * p.w;
    precise float depth = row_forward.x * v.x + row_forward.y * v.y + row_forward.z * v.z;
    precise float x = row_right.x * v.x + row_right.y * v.y + row_right.z * v.z;
    precise float y = row_up.x * v.x + row_up.y * v.y + row_up.z * v.z;
    precise vec4 clip = vec4(x + jitter.x * depth, y + jitter.y * depth, near_m * p.w, depth);
    return clip;
}
