// The scene, through the stage that also makes the volumes (see volume.geom).
layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;

#define WRITES_PLANE
#include "position.glsl"
#include "depth_plane.glsl"
#include "coverage.glsl"

invariant gl_Position;

void main() {
    vec4 p[3];
    for (uint k = 0u; k < 3u; k++) {
        p[k] = vec4(position_of(corners[3u * uint(gl_PrimitiveIDIn) + k]), 1.0);
    }
    if (is_outside(p[0], p[1], p[2]) || is_edge_on(p[0], p[1], p[2])) return;
    for (int k = 0; k < 3; k++) {
        set_depth_plane(p[0], p[1], p[2]);
        gl_PrimitiveID = gl_PrimitiveIDIn;
        gl_Position = set_coverage(p[0], p[1], p[2], k);
        EmitVertex();
    }
    EndPrimitive();
}
