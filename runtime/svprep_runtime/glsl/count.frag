// A fragment of a volume: adds 1 or takes 1, by the side that is seen and by how the draw
// runs against its faces' winding. The stencil counts the same without this output.
#include "depth_plane.glsl"
#include "coverage.glsl"

uniform float weight;

layout(location = 0) out float count;

void main() {
    if (!is_covered()) discard;
    gl_FragDepth = plane_depth();
#ifdef CUT_AT_NEAR
    if (gl_FragDepth > 1.0) discard;
#endif
    count = is_front != 0 ? weight : -weight;
}
