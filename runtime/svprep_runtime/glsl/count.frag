// A fragment of a volume: adds 1 or takes 1, by the side that is seen and by how the draw
// runs against its faces' winding. The stencil counts the same without this output.
#include "depth_plane.glsl"

uniform float weight;

layout(location = 0) out float count;

void main() {
    gl_FragDepth = plane_depth();
    count = gl_FrontFacing ? weight : -weight;
}
