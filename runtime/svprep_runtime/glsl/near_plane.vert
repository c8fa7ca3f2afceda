// zp+ (Hornus et al. 2005): faces projected from the light onto the near plane, those
// between the two. They count where the near plane begins in their shadow.
#include "position.glsl"

layout(std430, binding = 5) readonly buffer Entries { uvec2 entries[]; };

uniform int first_entry;
uniform vec4 light;

out float gl_ClipDistance[1];

void main() {
    uvec2 entry = entries[first_entry + gl_VertexID / 3];
    vec3 p = position_of(corners[3u * entry.x + uint(gl_VertexID % 3)]);
    vec3 n0 = eye + near_m * row_forward;
    vec4 q;
    if (light.w == 0.0) {
        float slope = dot(light.xyz, row_forward);
        float k = dot(p - n0, row_forward) / slope;
        q = vec4(p - k * light.xyz, 1.0);
        gl_ClipDistance[0] = k;
    } else {
        float reach = dot(n0 - light.xyz, row_forward);
        float side = reach < 0.0 ? -1.0 : 1.0;
        float w = side * dot(p - light.xyz, row_forward);
        q = vec4(light.xyz * w + (p - light.xyz) * abs(reach), w);
        gl_ClipDistance[0] = abs(reach) - w;
    }
    vec4 clip = clip_from_world(q);
    gl_Position = vec4(clip.xy, 0.5 * clip.w, clip.w);
}
