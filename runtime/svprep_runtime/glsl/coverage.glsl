// Which pixels a triangle holds, decided in float64 at their centres instead of by the
// rasteriser, which moves corners to a grid of 1/256 of a pixel.
//
//        . . . . . .      drawn: `wider_px` larger on every side, so that the rasteriser
//       .  /\      .      offers every pixel whose centre lies inside, or less beside than X'
//      .  /  \    .       of any pixel; kept: those asked at a place inside of the true edges
//     .  /____\  .
//    . . . . . . .
//
// Neighbours compute the same numbers of their common edge with opposite signs, and a centre
// on an edge is taken as if it lay a little to the right, and less above: it is in one of them.

#ifdef WRITES_PLANE
flat out dvec3 edge_line[3];  // how far inside of each edge, in pixels = x + y column + z row
flat out int is_front;

uniform vec2 size_px;

uniform float wider_px;

const vec4 NOWHERE = vec4(2, 2, 0, 1);

// All three lie beyond one side of the picture, by two pixels at least, or behind the eye: then
// nothing of the triangle is drawn, and what follows need not be worked out.
bool is_outside(vec4 a, vec4 b, vec4 c) {
    vec3 v[3] = vec3[3](vec3(from_eye(a)), vec3(from_eye(b)), vec3(from_eye(c)));
    float beyond = 0.01 + 4.0 / min(size_px.x, size_px.y);
    vec4 least = vec4(1e30);  // how far beyond each side all of them lie
    bool is_behind = true;
    for (int i = 0; i < 3; i++) {
        float x = dot(v[i], row_right), y = dot(v[i], row_up), depth = dot(v[i], row_forward);
        float rounding = 1e-5 * length(v[i]);
        float most = depth + beyond * abs(depth) + rounding;
        least = min(least, vec4(x, -x, y, -y) - most);
        is_behind = is_behind && depth < -rounding;
    }
    return is_behind || any(greaterThan(least, vec4(0.0)));
}

// How far inside of the edge from a to b (eye-relative, w = 0 at infinity) a pixel lies.
dvec3 line_of_edge(dvec3 a, dvec3 b, double turn) {
    precise dvec3 m = dvec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
    dvec3 corner = ray_of_sample(), right = ray_right, up = ray_up;
    precise dvec3 line = turn * dvec3(m.x * corner.x + m.y * corner.y + m.z * corner.z,
                                      m.x * right.x + m.y * right.y + m.z * right.z,
                                      m.x * up.x + m.y * up.y + m.z * up.z);
    double in_a_pixel = length(line.yz);
    return in_a_pixel > 0.0 ? line / in_a_pixel : line;
}

// The wedge of a triangle of which corner f alone lies before the eye: it ends nowhere.
dvec3 corner_of_wedge(dvec3 wide[3], int f, int k) {
    dvec2 after = wide[f].yz, before = wide[(f + 2) % 3].yz;
    if (k == (f + 2) % 3) {
        dvec2 swapped = after;
        after = before;
        before = swapped;
    }
    dvec2 away = dvec2(-after.y, after.x);
    return dvec3(0.0, dot(away, before) < 0.0 ? -away : away);
}

// Sets what the fragments ask; returns where corner k of the larger triangle is drawn.
vec4 set_coverage(vec4 a, vec4 b, vec4 c, int k) {
    dvec3 v[3] = dvec3[3](from_eye(a), from_eye(b), from_eye(c));
    double turn = dot(v[0], cross(v[1], v[2])) < 0.0 ? -1.0 : 1.0;
    is_front = turn < 0.0 ? 1 : 0;
    int f = 0, n_before = 0;
    for (int i = 0; i < 3; i++) {
        edge_line[i] = line_of_edge(v[i], v[(i + 1) % 3], turn);
        if (dot(v[i], dvec3(row_forward)) > 0.0) {
            f = i;
            n_before++;
        }
    }
    if (n_before == 0) return NOWHERE;
    dvec3 wide[3] = edge_line;
    for (int i = 0; i < 3; i++) wide[i].x += double(wider_px);
    // (w, w column, w row), a meeting of two edges. Of a triangle that reaches behind the eye,
    // the edge behind it may pass the corner before it: the larger triangle is inside out.
    dvec3 corner = -turn * cross(wide[(k + 2) % 3], wide[k]);
    bool is_turned = turn * dot(wide[0], cross(wide[1], wide[2])) >= 0.0;
    if (is_turned && k != f) corner = corner_of_wedge(wide, f, k);
    corner /= max(abs(corner.x), max(abs(corner.y), abs(corner.z)));
    return vec4(2.0 * corner.yz / dvec2(size_px) - corner.x, 0.0, corner.x);
}
#else
flat in dvec3 edge_line[3];
flat in int is_front;

// How far inside of edge k a place in the picture lies [pixels].
double inside_of_edge(int k, dvec2 at) {
    dvec3 line = edge_line[k];
    precise double inside = line.x + line.y * at.x + line.z * at.y;
    return inside;
}

bool is_covered(dvec2 at) {
    for (int k = 0; k < 3; k++) {
        double inside = inside_of_edge(k, at);
        if (inside == 0.0) inside = edge_line[k].y == 0.0 ? edge_line[k].z : edge_line[k].y;
        if (inside <= 0.0) return false;
    }
    return true;
}
#endif
