// X, displaced to the eye's side of its face: the depth that volumes are counted against.
// Computed from the face's own plane through the centre of the sample, in float64: what the
// rasteriser rounds, of this face or of a volume that begins on it, is less than `lift_px`.
#include "mesh.glsl"

layout(binding = 0) uniform usampler2D seen_of_pixel;

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

uniform float most_slant;   // a ray that grazes is followed no farther than this many lifts

dvec3 from_eye(uint face, uint k) {
    return dvec3(corner_of(face, k)) - dvec3(eye);
}

void main() {
    uint seen = texelFetch(seen_of_pixel, ivec2(gl_FragCoord.xy), 0).r;
    if (seen == 0u) {
        gl_FragDepth = 0.0;
        return;
    }
    uint face = (seen & 0x7fffffffu) - 1u;
    dvec3 a = from_eye(face, 0u), b = from_eye(face, 1u), c = from_eye(face, 2u);
    dvec3 n = cross(b - a, c - a);
    vec2 at = gl_FragCoord.xy - offset_px;
    dvec3 ray = ray_corner + double(at.x) * ray_right + double(at.y) * ray_up;
    dvec3 forward = dvec3(row_forward);
    double da = dot(a, forward), db = dot(b, forward), dc = dot(c, forward);
    double slope = abs(dot(n, ray));
    double depth = slope > 0.0 ? abs(dot(n, a)) / slope : da;
    depth = clamp(depth, min(da, min(db, dc)), max(da, max(db, dc)));
    double lift = clamp(double(lift_px) * length(ray_right) * depth,
                        double(least_lift_m), double(most_lift_m));
    double length_n = length(n), length_ray = length(ray);
    double slant = slope * double(most_slant) > length_n * length_ray ? length_n / slope
                                                              : double(most_slant) / length_ray;
    depth = max(depth - lift * slant, double(near_m));
    gl_FragDepth = min(float(double(near_m) / depth), 0.9999999);
}
