// The volume of one face in one segment, without the sides that its neighbours close.
// Adjacency is by faces: a side stands where the neighbour's uploaded facing differs.
// (Stich, Waechter, Keller 2007; GPU Gems 3, ch. 11.)
// Where this draws volumes, visible.geom draws the scene: a driver may round what leaves a
// geometry shader otherwise than what leaves a vertex shader, and caps must meet the scene.
layout(points) in;
layout(triangle_strip, max_vertices = 24) out;

#define WRITES_PLANE
#include "position.glsl"
#include "extrude.glsl"
#include "depth_plane.glsl"
#include "coverage.glsl"
#include "facing.glsl"

layout(std430, binding = 5) readonly buffer Entries { uvec2 entries[]; };
layout(std430, binding = 7) readonly buffer Neighbours { uint neighbours[]; };  // 3 a face

flat in int entry_of_vertex[];

uniform bool has_all_caps;  // z-pass needs no light cap, and none at infinity

const uint NO_INDEX = 0xffffffffu;

invariant gl_Position;

void triangle(vec4 a, vec4 b, vec4 c) {
    if (is_outside(a, b, c)) return;
    for (int k = 0; k < 3; k++) {
        set_depth_plane(a, b, c);
        gl_Position = set_coverage(a, b, c, k);
        EmitVertex();
    }
    EndPrimitive();
}

void main() {
    uvec2 entry = entries[entry_of_vertex[0]];
    uint face = entry.x;
    int s = facing_of(face);
    vec4 segment = segments[entry.y];
    bool has_end = segment.y < ENDLESS;
    bool is_to_point = !has_end && light.w == 0.0;
    vec4 near_end[3], far_end[3];
    for (uint k = 0u; k < 3u; k++) {
        vec3 p = corner_of(face, k);
        near_end[k] = end_of_segment(p, entry.y, false);
        far_end[k] = end_of_segment(p, entry.y, true);
    }
    if (has_all_caps || segment.x > -ENDLESS) triangle(near_end[0], near_end[1], near_end[2]);
    if (has_end || (has_all_caps && !is_to_point)) triangle(far_end[2], far_end[1], far_end[0]);
    for (uint k = 0u; k < 3u; k++) {
#ifndef EACH_ALONE
        uint beyond = neighbours[3u * face + k];
        if ((beyond == NO_INDEX ? 0 : facing_of(beyond)) == s) continue;
#endif
        uint next = (k + 1u) % 3u;
        triangle(near_end[next], near_end[k], far_end[k]);
        if (!is_to_point) triangle(near_end[next], far_end[k], far_end[next]);
    }
}
