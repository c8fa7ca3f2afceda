// Lines; sides and caps of volumes as glass: one tint for each side that is seen.
#ifdef OF_VOLUME
#include "depth_plane.glsl"
#include "coverage.glsl"
#endif

uniform vec4 front;
uniform vec4 back;

layout(location = 0) out vec4 shown;

void main() {
#ifdef OF_VOLUME
    dvec2 at = dvec2(gl_FragCoord.xy);
    if (!is_covered(at)) discard;
    gl_FragDepth = plane_depth(at);
    shown = is_front != 0 ? front : back;
#else
    shown = front;
#endif
}
