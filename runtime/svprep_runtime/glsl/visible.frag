// What each pixel sees: 1 + the face, and in the highest bit whether its front.
#include "depth_plane.glsl"
#include "coverage.glsl"

uniform float near_m;

layout(location = 0) out uint seen;

void main() {
    if (!is_covered()) discard;
    float z = plane_depth();
#ifdef CUT_AT_NEAR
    // Depth clamp keeps what is nearer than the near plane, so that it casts; it is not seen.
    if (z > 1.0) discard;
#endif
    gl_FragDepth = z;
    seen = uint(gl_PrimitiveID + 1) | (is_front != 0 ? 0x80000000u : 0u);
}
