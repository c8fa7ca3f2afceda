// The scene: vertex k of the draw is corner k of the faces, in their own order.
#define WRITES_PLANE
#include "position.glsl"
#include "depth_plane.glsl"
#include "coverage.glsl"

invariant gl_Position;

void main() {
    uint first = 3u * (uint(gl_VertexID) / 3u);
    vec4 p[3];
    for (uint k = 0u; k < 3u; k++) p[k] = vec4(position_of(corners[first + k]), 1.0);
    gl_Position = NOWHERE;
    if (is_outside(p[0], p[1], p[2]) || is_edge_on(p[0], p[1], p[2])) return;
    set_depth_plane(p[0], p[1], p[2]);
    gl_Position = set_coverage(p[0], p[1], p[2], gl_VertexID % 3);
}
