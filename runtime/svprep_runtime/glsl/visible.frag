// What each pixel sees: 1 + the face, and in the highest bit whether its front.
#include "depth_plane.glsl"
#include "inner_depth.glsl"

uniform float near_m;

layout(location = 0) out uint seen;

void main() {
#ifdef CUT_AT_NEAR
    // Depth clamp keeps what is nearer than the near plane, so that it casts; it is not seen.
    if (gl_FragCoord.w * near_m > 1.0) discard;
#endif
    gl_FragDepth = inner_depth();
    seen = uint(gl_PrimitiveID + 1) | (gl_FrontFacing ? 0x80000000u : 0u);
}
