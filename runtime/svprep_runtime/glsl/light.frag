// lit = nothing counted, and the side seen is the side that faces the light.
// A count below 0 is impossible for closed volumes: where the rasteriser makes one, a sliver
// was taken in the wrong order, nothing holds the point, and the pixel is tallied.
#include "mesh.glsl"
#include "facing.glsl"

layout(std430, binding = 6) buffer Tally { uint tally[]; };  // 0: negative pixels, 1: highest count

layout(binding = 0) uniform usampler2D seen_of_pixel;
#ifdef IN_STENCIL
layout(binding = 1) uniform usampler2D count_of_pixel;
#else
layout(binding = 1) uniform sampler2D count_of_pixel;
#endif

uniform vec4 light;
uniform float brightness;

layout(location = 0) out vec4 radiance;
layout(location = 1) out float in_shadow;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    uint seen = texelFetch(seen_of_pixel, pixel, 0).r;
    radiance = vec4(0.0);
    in_shadow = 0.0;
    int count = int(texelFetch(count_of_pixel, pixel, 0).r);
    if (count < 0) atomicAdd(tally[0], 1u);
    else if (count > 0) atomicMax(tally[1], uint(count));
    if (seen == 0u) return;
    uint face = (seen & 0x7fffffffu) - 1u;
    int s = facing_of(face);
    bool is_front = (seen & 0x80000000u) != 0u;
    bool is_lit = count <= 0 && s != 0 && (s > 0) == is_front;
    in_shadow = is_lit ? 0.0 : 1.0;
    if (is_lit) {
        vec3 a = corner_of(face, 0u);
        vec3 n = cross(corner_of(face, 1u) - a, corner_of(face, 2u) - a);
        vec3 towards = light.w != 0.0 ? light.xyz - a : light.xyz;
        float cosine = abs(dot(normalize(n), normalize(towards)));
        // What is lit is told from what is not, however low the sun.
        radiance = vec4(vec3(brightness * (0.12 + 0.88 * cosine)), 0.0);
    }
}
