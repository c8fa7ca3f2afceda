// What each pixel sees: 1 + the face, and in the highest bit whether its front.
#include "depth_plane.glsl"
#include "coverage.glsl"

#ifdef AGAIN
layout(binding = 1) uniform sampler2D depth_of_pixel;
layout(binding = 0, rgba32ui) uniform uimage2D displaced;  // see displace.frag

uniform float near_m;
uniform float lift_px;
uniform float least_lift_m;
uniform float most_shift_px;
#endif

layout(location = 0) out uint seen;
#ifndef AGAIN
layout(location = 1) out float depth;

void main() {
    dvec2 at = dvec2(gl_FragCoord.xy);
    if (!is_covered(at)) discard;
    float z = plane_depth(at);
#ifdef CUT_AT_NEAR
    // Depth clamp keeps what is nearer than the near plane, so that it casts; it is not seen.
    if (z > 1.0) discard;
#endif
    gl_FragDepth = z;
    depth = z;
    seen = uint(gl_PrimitiveID + 1) | (is_front != 0 ? 0x80000000u : 0u);
}
#else
// Marks the pixel if this face hides its X' from the eye.
void mark_if_hidden(dvec2 at, ivec2 pixel, uvec4 found) {
    dvec2 beside = at + dvec2(uintBitsToFloat(found.xy));
    float z = plane_depth(beside);
#ifdef CUT_AT_NEAR
    if (z > 1.0) return;
#endif
    if (z < uintBitsToFloat(found.z) || !is_covered(beside)) return;
    found.z |= 0x80000000u;
    imageStore(displaced, pixel, found);
}

// Of all faces with the nearest float32 depth: how far before or behind it, in half ulps.
void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    dvec2 at = dvec2(gl_FragCoord.xy);
    float z = plane_depth(at), nearest = texelFetch(depth_of_pixel, pixel, 0).r;
    if (z != nearest || !is_covered(at)) {
        // Beside the centre this face may be nearer, and X' deeper than X by a lift.
        double turn = most_shift_px * (abs(depth_plane.y) + abs(depth_plane.z));
        double deeper = lift_px * length(ray_right) + double(least_lift_m * nearest / near_m);
        if (nearest > 0.0 && double(z) + turn > double(nearest) * (1.0 - deeper)) {
            mark_if_hidden(at, pixel, imageLoad(displaced, pixel));
        }
        discard;
    }
    seen = uint(gl_PrimitiveID + 1) | (is_front != 0 ? 0x80000000u : 0u);
    uvec4 found = imageLoad(displaced, pixel);
    if (seen != found.w) mark_if_hidden(at, pixel, found);
    double half_ulp = 0.5 * (double(uintBitsToFloat(floatBitsToUint(z) + 1u)) - double(z));
    double rest = (plane_depth_unrounded(at) - double(z)) / half_ulp;
    gl_FragDepth = float(0.5 + 0.25 * clamp(rest, -1.0, 1.0));
}
#endif
