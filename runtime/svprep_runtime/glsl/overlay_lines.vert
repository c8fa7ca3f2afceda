// Lines of one width on the screen: entry (edge record; segment), six vertices each.
// They lie a thousandth nearer than what they run along, so that it does not hide them.
#include "position.glsl"
#include "extrude.glsl"

layout(std430, binding = 2) readonly buffer EdgeVertices { uvec2 edge_vertices[]; };
layout(std430, binding = 5) readonly buffer Entries { uvec2 entries[]; };

uniform int first_entry;
uniform int which;       // 0: the edge itself; 1, 2: where its segment begins, ends
uniform vec2 half_line;  // half the width of a line, in clip units

const float NEARER = 1.001;

void main() {
    uvec2 entry = entries[first_entry + gl_VertexID / 6];
    uvec2 ends = edge_vertices[entry.x & 0x7fffffffu];
    vec4 s = segments[entry.y];
    gl_Position = vec4(2.0, 2.0, 0.0, 1.0);  // nowhere
    if ((which == 1 && s.x <= -ENDLESS) || (which == 2 && s.y >= ENDLESS)) return;
    vec4 a = vec4(position_of(ends.x), 1.0);
    vec4 b = vec4(position_of(ends.y), 1.0);
    if (which != 0) {
        a = end_of_segment(a.xyz, entry.y, which == 2);
        b = end_of_segment(b.xyz, entry.y, which == 2);
    }
    a = clip_from_world(a);
    b = clip_from_world(b);
    if (a.w < near_m && b.w < near_m) return;
    if (a.w < near_m) a = mix(b, a, (b.w - near_m) / (b.w - a.w));
    if (b.w < near_m) b = mix(a, b, (a.w - near_m) / (a.w - b.w));
    vec2 along = (b.xy / b.w - a.xy / a.w) / half_line;
    float reach = length(along);
    if (reach < 1e-3) return;
    vec2 across = vec2(-along.y, along.x) / reach * half_line;
    int corner = int[6](0, 1, 2, 0, 2, 3)[gl_VertexID % 6];
    vec4 p = corner == 0 || corner == 3 ? a : b;
    p.xy += (corner < 2 ? across : -across) * p.w;
    p.z *= NEARER;
    gl_Position = p;
}
