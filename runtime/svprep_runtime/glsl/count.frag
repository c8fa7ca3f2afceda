// A fragment of a volume: adds 1 or takes 1, by the side that is seen and by how the draw
// runs against its faces' winding. The stencil counts the same without this output.
#include "depth_plane.glsl"
#include "coverage.glsl"

layout(binding = 2) uniform usampler2D displaced;  // see displace.frag

uniform float weight;

layout(location = 0) out float count;

void main() {
    uvec2 shift = texelFetch(displaced, ivec2(gl_FragCoord.xy), 0).xy;
    dvec2 at = dvec2(gl_FragCoord.xy) + dvec2(uintBitsToFloat(shift));
    if (!is_covered(at)) discard;
    gl_FragDepth = plane_depth(at);
#ifdef CUT_AT_NEAR
    if (gl_FragDepth > 1.0) discard;
#endif
    count = is_front != 0 ? weight : -weight;
}
