// zp+ (Hornus et al. 2005): faces projected from the light onto the near plane, those
// between the two. They count where the near plane begins in their shadow.
#include "position.glsl"

layout(std430, binding = 5) readonly buffer Entries { uvec2 entries[]; };

uniform int first_entry;
uniform vec4 light;

out float gl_ClipDistance[1];

// Everything relative to the eye and in float64: the near rectangle is centimetres wide, the
// light may be kilometres away.
void main() {
    uvec2 entry = entries[first_entry + gl_VertexID / 3];
    dvec3 p = dvec3(position_of(corners[3u * entry.x + uint(gl_VertexID % 3)])) - dvec3(eye);
    dvec3 forward = dvec3(row_forward);
    double before = dot(p, forward) - double(near_m);  // how far beyond the near plane
    dvec3 q;
    double w;
    if (light.w == 0.0) {
        double slope = dot(dvec3(light.xyz), forward);
        double side = slope < 0.0 ? -1.0 : 1.0;
        w = abs(slope);
        q = p * w - side * before * dvec3(light.xyz);
        gl_ClipDistance[0] = float(side * before);
    } else {
        dvec3 lamp = dvec3(light.xyz) - dvec3(eye);
        double reach = double(near_m) - dot(lamp, forward);
        w = (reach < 0.0 ? -1.0 : 1.0) * dot(p - lamp, forward);
        q = lamp * w + (p - lamp) * abs(reach);
        gl_ClipDistance[0] = float(abs(reach) - w);
    }
    float depth = float(dot(q, forward));
    float x = float(dot(q, dvec3(row_right))), y = float(dot(q, dvec3(row_up)));
    gl_Position = vec4(x + jitter.x * depth, y + jitter.y * depth, 0.5 * depth, depth);
}
