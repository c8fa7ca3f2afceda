// The scene: vertex k of the draw is corner k of the faces, in their own order.
#include "position.glsl"

invariant gl_Position;

void main() {
    gl_Position = clip_from_world(vec4(position_of(corners[gl_VertexID]), 1.0));
}
