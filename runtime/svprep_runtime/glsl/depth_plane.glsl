// The depth of a volume's triangle, from its own plane instead of the rasteriser's.
//
// A rasteriser interpolates depth between corners that it has moved to a grid of 1/256 of a
// pixel. Of a side that is a hundredth of a pixel wide and hundreds long, that turns the
// plane: metres are missed. So the plane through the eye-relative corners v, with
// q . v = w of each corner (1; at infinity 0), is solved in float64: along a ray of view
// depth 1, 1 / depth = q . ray, which is linear in the picture.

uniform dvec3 ray_corner;  // of view depth 1: to the lower left corner of the picture,
uniform dvec3 ray_right;   // and what a pixel to the right or up adds. In float32 they would
uniform dvec3 ray_up;      // move centres by up to 0.0001 pixel, off a face's edge
uniform vec2 offset_px;    // by which the picture is shifted for this sample

#ifdef WRITES_PLANE
flat out dvec3 depth_plane;  // reversed depth = x + y column + z row
flat out vec2 depth_range;  // of the triangle: what rounding may not leave

dvec3 from_eye(vec4 p) {
    return dvec3(p.xyz) - dvec3(eye) * double(p.w);
}

// Of view depth 1: to the lower left corner of the picture, as this sample is shifted.
dvec3 ray_of_sample() {
    return ray_corner - double(offset_px.x) * ray_right - double(offset_px.y) * ray_up;
}

// The eye lies in the plane of these points: a face that is seen so shows no point, though a
// rasteriser may draw one that passes through the eye all over the picture.
bool is_edge_on(vec4 a, vec4 b, vec4 c) {
    dvec3 va = from_eye(a);
    return dot(va, cross(from_eye(b) - va, from_eye(c) - va)) == 0.0;
}

void set_depth_plane(vec4 a, vec4 b, vec4 c) {
    dvec3 va = from_eye(a), vb = from_eye(b), vc = from_eye(c);
    dvec3 across = cross(vb, vc);
    double volume = dot(va, across);
    dvec3 q = double(a.w) * across + double(b.w) * cross(vc, va) + double(c.w) * cross(va, vb);
    vec3 ws = vec3(a.w, b.w, c.w);
    vec3 depths = vec3(dot(vec3(va), row_forward), dot(vec3(vb), row_forward),
                       dot(vec3(vc), row_forward));
    depth_range = vec2(1.0, 0.0);
    for (int k = 0; k < 3; k++) {
        if (depths[k] > 0.0) {
            float z = near_m * ws[k] / depths[k];
            depth_range = vec2(min(depth_range.x, z), max(depth_range.y, z));
        } else {
            depth_range.y = 1e30;
        }
    }
    // The eye lies in the triangle's plane: wherever rounding draws it, it is as near as can be.
    depth_plane = dvec3(depth_range.y, 0.0, 0.0);
    if (volume == 0.0) return;
    q *= double(near_m) / volume;
    depth_plane = dvec3(dot(q, ray_of_sample()), dot(q, ray_right), dot(q, ray_up));
}
#else
flat in dvec3 depth_plane;
flat in vec2 depth_range;

// At a place in the picture [pixels].
double plane_depth_unrounded(dvec2 at) {
    precise double z = depth_plane.x + depth_plane.y * at.x + depth_plane.z * at.y;
    // With a corner behind the eye, rounding may draw the triangle on the eye's other side,
    // where its plane lies behind the eye: just as near as its mirror image before it.
    return depth_range.y > 1e29 ? abs(z) : z;
}

float plane_depth(dvec2 at) {
    return clamp(float(plane_depth_unrounded(at)), depth_range.x, depth_range.y);
}
#endif
