// Light from the sky: brighter on what looks up; and the sky itself.
#include "mesh.glsl"

layout(binding = 0) uniform usampler2D seen_of_pixel;

layout(location = 0) out vec4 radiance;

void main() {
    uint seen = texelFetch(seen_of_pixel, ivec2(gl_FragCoord.xy), 0).r;
    if (seen == 0u) {
        radiance = vec4(0.62, 0.74, 0.86, 0.0);
        return;
    }
    uint face = (seen & 0x7fffffffu) - 1u;
    vec3 a = corner_of(face, 0u);
    vec3 n = normalize(cross(corner_of(face, 1u) - a, corner_of(face, 2u) - a));
    if ((seen & 0x80000000u) == 0u) n = -n;
    // A little by compass direction, so that two walls in shadow are told apart.
    radiance = vec4(vec3(0.20, 0.22, 0.26) * (0.8 + 0.2 * n.z + 0.14 * n.x + 0.07 * n.y), 1.0);
}
