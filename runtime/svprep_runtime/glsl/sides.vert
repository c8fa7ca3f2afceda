// Sides: entry (edge record, with the highest bit where m > 0; segment).
//
//     near end   a ---- b     m > 0: a = v1, b = v0     triangles a b b', a b' a'
//                |    / |     m < 0: a = v0, b = v1     TO_A_POINT: a b, and the point
//     far end    a' --- b'                              at infinity that all sides share
#define WRITES_PLANE
#include "position.glsl"
#include "extrude.glsl"
#include "depth_plane.glsl"
#include "coverage.glsl"

layout(std430, binding = 2) readonly buffer EdgeVertices { uvec2 edge_vertices[]; };
layout(std430, binding = 5) readonly buffer Entries { uvec2 entries[]; };

uniform int first_entry;

invariant gl_Position;

void main() {
#ifdef TO_A_POINT
    uvec2 entry = entries[first_entry + gl_VertexID / 3];
    bool is_second = false;
#else
    uvec2 entry = entries[first_entry + gl_VertexID / 6];
    bool is_second = gl_VertexID % 6 >= 3;
#endif
    uvec2 ends = edge_vertices[entry.x & 0x7fffffffu];
    bool starts_at_v1 = (entry.x & 0x80000000u) != 0u;
    vec3 a = position_of(starts_at_v1 ? ends.y : ends.x);
    vec3 b = position_of(starts_at_v1 ? ends.x : ends.y);
    vec4 p[3];
    p[0] = end_of_segment(a, entry.y, false);
    p[1] = is_second ? end_of_segment(b, entry.y, true) : end_of_segment(b, entry.y, false);
    p[2] = end_of_segment(is_second ? a : b, entry.y, true);
    gl_Position = NOWHERE;
    if (is_outside(p[0], p[1], p[2])) return;
    set_depth_plane(p[0], p[1], p[2]);
    gl_Position = set_coverage(p[0], p[1], p[2], gl_VertexID % 3);
}
