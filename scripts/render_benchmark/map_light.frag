#version 450 core
// Light by one look into a shadow map, where the visible point is on the ray in its face's
// plane; what turns away from the light is in shadow without a look.
layout(std430, binding = 0) readonly buffer Positions { float positions[]; };
layout(std430, binding = 1) readonly buffer Corners { uint corners[]; };
layout(std430, binding = 3) readonly buffer Facing { uint facing[]; };
layout(binding = 0) uniform usampler2D seen_of_pixel;
layout(binding = 1) uniform sampler2D depth_of_texel;
uniform mat4 map_from_world;
uniform vec4 light;
uniform vec3 eye;
uniform vec3 ray_corner;
uniform vec3 ray_right;
uniform vec3 ray_up;
uniform float brightness;
uniform float bias;        // in depth of the map, for a slope of 1
layout(location = 0) out vec4 radiance;
layout(location = 1) out float in_shadow;

vec3 corner(uint face, uint k) {
    uint v = 3u * corners[3u * face + k];
    return vec3(positions[v], positions[v + 1u], positions[v + 2u]) - eye;
}

void main() {
    uint seen = texelFetch(seen_of_pixel, ivec2(gl_FragCoord.xy), 0).r;
    radiance = vec4(0.0);
    in_shadow = 0.0;
    if (seen == 0u) return;
    uint face = (seen & 0x7fffffffu) - 1u;
    int s = int(facing[face >> 2u] << (24u - 8u * (face & 3u))) >> 24;
    bool is_front = (seen & 0x80000000u) != 0u;
    in_shadow = 1.0;
    if (s == 0 || (s > 0) != is_front) return;
    vec3 a = corner(face, 0u);
    vec3 n = normalize(cross(corner(face, 1u) - a, corner(face, 2u) - a));
    vec3 ray = ray_corner + gl_FragCoord.x * ray_right + gl_FragCoord.y * ray_up;
    vec3 x = eye + ray * (dot(n, a) / dot(n, ray));
    float cosine = abs(dot(n, light.xyz));
    vec3 at = (map_from_world * vec4(x, 1.0)).xyz;
    float slope = min(sqrt(1.0 - min(cosine * cosine, 1.0)) / max(cosine, 1e-3), 10.0);
    if (texture(depth_of_texel, at.xy * 0.5 + 0.5).r < at.z - bias * (1.0 + slope)) return;
    in_shadow = 0.0;
    radiance = vec4(vec3(brightness * cosine), 0.0);
}
