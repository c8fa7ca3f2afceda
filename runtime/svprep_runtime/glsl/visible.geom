// The scene, through the stage that also makes the volumes (see volume.geom).
layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;

#include "position.glsl"

invariant gl_Position;

void main() {
    for (uint k = 0u; k < 3u; k++) {
        uint vertex = corners[3u * uint(gl_PrimitiveIDIn) + k];
        gl_PrimitiveID = gl_PrimitiveIDIn;
        gl_Position = clip_from_world(vec4(position_of(vertex), 1.0));
        EmitVertex();
    }
    EndPrimitive();
}
