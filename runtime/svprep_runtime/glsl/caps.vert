// Caps: entry (face, segment), three vertices each, in the scene's own order of corners.
#define WRITES_PLANE
#include "position.glsl"
#include "extrude.glsl"
#include "depth_plane.glsl"
#include "coverage.glsl"

layout(std430, binding = 5) readonly buffer Entries { uvec2 entries[]; };

uniform bool is_far;
uniform int first_entry;

invariant gl_Position;

void main() {
    uvec2 entry = entries[first_entry + gl_VertexID / 3];
    vec4 p[3];
    for (uint k = 0u; k < 3u; k++) {
        p[k] = end_of_segment(position_of(corners[3u * entry.x + k]), entry.y, is_far);
    }
    gl_Position = NOWHERE;
    if (is_outside(p[0], p[1], p[2])) return;
    set_depth_plane(p[0], p[1], p[2]);
    gl_Position = set_coverage(p[0], p[1], p[2], gl_VertexID % 3);
}
