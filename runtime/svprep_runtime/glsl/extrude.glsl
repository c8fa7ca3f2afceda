// The two ends of a segment of a shadow volume, for a point of its caster.

layout(std430, binding = 4) readonly buffer Segments { vec4 segments[]; };  // near far p q

uniform vec4 light;      // (x, y, z, 1) a point, (x, y, z, 0) the direction towards it
uniform vec3 light_u;    // light frame of a directional light; t points away from it
uniform vec3 light_v;
uniform vec3 light_t;
uniform float reach_m;   // how far X may have been displaced: segments reach so much farther

const float ENDLESS = 1e37;  // what stands for infinity: at the caster itself, or at no end

// Of a point light's segments, as a share of the distance from the light.
const float REACH = 0.02;

// Plane projection of clamped volumes (Steiner 2006), homothety for point lights. What lies
// behind the caster is in its shadow, so a segment may be longer than it need be, but may
// not begin before the caster.
vec4 end_of_segment(vec3 p, uint segment, bool is_far) {
    vec4 s = segments[segment];
    float depth = is_far ? s.y : s.x;
    if (depth <= -ENDLESS) return vec4(p, 1.0);
    if (depth >= ENDLESS) return vec4(p * light.w - light.xyz, 0.0);
    if (light.w != 0.0) {
        depth = is_far ? depth * (1.0 + REACH) : max(depth * (1.0 - REACH), 1.0);
        return vec4(p + (depth - 1.0) * (p - light.xyz), 1.0);  // exact at the caster itself
    }
    precise float at = dot(light_t, p) - s.z * dot(light_u, p) - s.w * dot(light_v, p);
    float reach = reach_m * sqrt(1.0 + s.z * s.z + s.w * s.w);
    float away = is_far ? depth + reach - at : max(depth - reach - at, 0.0);
    return vec4(p + away * light_t, 1.0);
}
