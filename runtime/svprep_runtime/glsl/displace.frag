// X, displaced to the eye's side of its face: where volumes are counted.
//
//     eye         X' lies along the normal, as the definition has it, and so beside the
//        \   X'   centre of the pixel; there volumes are asked. If it lies farther beside
//         o--|    than `most_shift_px`, it is taken between X' and the ray. Where another
//          \ |    face hides X' from the eye, z-pass could not count to it: then it is
//           \|    taken on the ray itself.
//     _______X______ face
//
// All in float64, from the face's own plane.
#include "mesh.glsl"

layout(binding = 0) uniform usampler2D seen_of_pixel;
// (x, y, z, seen): from the centre of the pixel to X' [pixels], its reversed depth, floats by
// their bits, z negative where X' is hidden; and of what is seen.
layout(binding = 0, rgba32ui) uniform uimage2D displaced;
layout(std430, binding = 6) buffer Tally { uint tally[]; };  // 2: how far beside any X' lies

uniform vec3 eye;
uniform vec3 row_forward;
uniform float near_m;
uniform dvec3 ray_corner;  // of view depth 1: to the lower left corner of the picture,
uniform dvec3 ray_right;   // and what a pixel to the right or up adds
uniform dvec3 ray_up;
uniform vec2 offset_px;    // by which the picture is shifted for this sample
uniform float lift_px;     // displacement, in pixels at the depth of X,
uniform float least_lift_m;
uniform float most_lift_m;
uniform float most_slant;  // a ray that grazes is followed no farther than this many lifts
uniform float most_shift_px;

dvec3 from_eye(uint face, uint k) {
    return dvec3(corner_of(face, k)) - dvec3(eye);
}

// X' of a face, as above: shift [pixels] and reversed depth.
vec3 displace(uint face, double most) {
    dvec3 a = from_eye(face, 0u), b = from_eye(face, 1u), c = from_eye(face, 2u);
    dvec3 n = normalize(cross(b - a, c - a));
    if (dot(n, a) > 0.0) n = -n;  // towards the eye
    dvec3 forward = dvec3(row_forward);
    vec2 at = gl_FragCoord.xy - offset_px;
    dvec3 ray = ray_corner + double(at.x) * ray_right + double(at.y) * ray_up;
    double da = dot(a, forward), db = dot(b, forward), dc = dot(c, forward);
    double slope = -dot(n, ray);
    double depth = slope > 0.0 ? -dot(n, a) / slope : da;
    depth = clamp(depth, min(da, min(db, dc)), max(da, max(db, dc)));
    double lift = clamp(double(lift_px) * length(ray_right) * depth,
                        double(least_lift_m), double(most_lift_m));

    double lifted = depth + lift * dot(n, forward);
    dvec3 beside = (n - dot(n, forward) * ray) * (lift / max(lifted, double(near_m)));
    dvec2 shift = dvec2(dot(beside, ray_right) / dot(ray_right, ray_right),
                        dot(beside, ray_up) / dot(ray_up, ray_up));
    if (lifted < double(near_m)) most = 0.0;
    double far_px = length(shift);
    if (far_px > most) {
        double slant = double(most_slant) / length(ray);
        if (slope * slant > 1.0) slant = 1.0 / slope;
        double on_ray = depth - lift * slant;
        double share = most * on_ray / (far_px * lifted - most * (lifted - on_ray));
        lifted = on_ray + share * (lifted - on_ray);
        shift *= most / far_px;
    }
    double z = double(near_m) / max(lifted, double(near_m));
    return vec3(shift, min(float(z), 0.9999999));
}

#ifdef AGAIN
// On the ray where X' is hidden, or may be, of another face than was thought; writes the depth.
void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    uvec4 found = imageLoad(displaced, pixel);
    uint seen = texelFetch(seen_of_pixel, pixel, 0).r;
    if ((found.z & 0x80000000u) != 0u || seen != found.w) {
        found.xyz = floatBitsToUint(displace((seen & 0x7fffffffu) - 1u, 0.0));
        imageStore(displaced, pixel, found);
    }
    gl_FragDepth = uintBitsToFloat(found.z);
}
#else
void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    uint seen = texelFetch(seen_of_pixel, pixel, 0).r;
    uvec4 found = uvec4(0u);
    if (seen != 0u) {
        vec3 x = displace((seen & 0x7fffffffu) - 1u, double(most_shift_px));
        found = uvec4(floatBitsToUint(x), seen);
        uint far = floatBitsToUint(length(x.xy));
        if (far > tally[2]) atomicMax(tally[2], far);
    }
    imageStore(displaced, pixel, found);
}
#endif
