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
const double FARTHEST_PX = 16384.0;  // where float32 still has steps of 1/1024
const double LEAST_SINE = 1e-4;

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

// How far off a corner (w, w column, w row) lies, or a side of the picture; times |w|.
double reach_of(dvec3 corner) {
    double side = max(size_px.x, size_px.y);
    return max(side * abs(corner.x), max(abs(corner.y), abs(corner.z)));
}

// The corners of the larger triangle, (w, w column, w row) with w = 0 at infinity, and whether
// float32 and clipping keep its edges in the picture where they are, to a fraction of ROUNDING_PX.
bool find_corners(dvec3 wide[3], bool is_before[3], int n_before, double turn,
                  out dvec3 corner[3]) {
    int n_far = 0;
    double sine = 0.0;  // of the bluntest corner: with none, all edges are one line
    for (int i = 0; i < 3; i++) {
        dvec3 ends = wide[(i + 2) % 3], begins = wide[i], opposite = wide[(i + 1) % 3];
        corner[i] = -turn * cross(ends, begins);
        if (n_before == 1 && !is_before[i]) {  // a wedge, which ends nowhere
            dvec2 line = is_before[(i + 2) % 3] ? ends.yz : begins.yz;
            dvec2 away = dvec2(-line.y, line.x);
            corner[i] = dvec3(0.0, dot(away, opposite.yz) < 0.0 ? -away : away);
        }
        sine = max(sine, abs(corner[i].x));
        double most = max(abs(corner[i].y), abs(corner[i].z));
        if (most >= FARTHEST_PX * abs(corner[i].x)) n_far++;
    }
    // An edge between corners that are far off is turned; a wedge has two of them, and no edge.
    if (sine < LEAST_SINE || n_far > (n_before == 1 ? 2 : 1)) return false;
    if (n_before != 2) return true;
    // So is one to a corner behind the eye whose mirror image lies close to the other corner.
    for (int i = 0; i < 3; i++) {
        dvec3 a = corner[i], b = corner[(i + 1) % 3];
        if (is_before[i] == is_before[(i + 1) % 3]) continue;
        dvec2 apart = abs(a.yz * b.x - b.yz * a.x);
        if (max(apart.x, apart.y) * FARTHEST_PX <= reach_of(a) * reach_of(b)) return false;
    }
    // Growing, the edge before the eye may have passed that image: it is inside out.
    return dot(wide[1], corner[0]) > 0.0;
}

// Narrows a rectangle to about that part of it which lies inside of a line.
void narrow(inout dvec2 least, inout dvec2 most, dvec3 line) {
    dvec2 highest = max(line.yz * least, line.yz * most);
    dvec2 ends = -(line.x + highest.yx) / line.yz;
    if (line.y > 0.0) least.x = max(least.x, ends.x);
    if (line.y < 0.0) most.x = min(most.x, ends.x);
    if (line.z > 0.0) least.y = max(least.y, ends.y);
    if (line.z < 0.0) most.y = min(most.y, ends.y);
}

// Where corner k of another triangle is drawn, with which float32 has no trouble. It holds all
// of the larger triangle that lies in the picture: twice as wide and high as a rectangle about
// that, which lies along its sharpest corner, for most are slivers.
//
//    |'.
//    |  '.
//    +----'.
//    |_____|'.
vec4 corner_around(dvec3 wide[3], int k) {
    double sharpest = 2.0;
    dvec2 v = dvec2(0.0);
    for (int i = 0; i < 3; i++) {
        double sine = abs(determinant(dmat2(wide[(i + 2) % 3].yz, wide[i].yz)));
        if (sine < sharpest && wide[i].yz != dvec2(0.0)) {
            sharpest = sine;
            v = wide[i].yz;
        }
    }
    dvec2 u = dvec2(v.y, -v.x), picture = dvec2(size_px);
    dvec2 middle = 0.5 * dvec2(dot(u, picture), dot(v, picture));
    dvec2 reach = 0.5 * dvec2(dot(abs(u), picture), dot(abs(v), picture)) + 1.0;
    dvec2 least = middle - reach, most = middle + reach;
    for (int i = 0; i < 3; i++) {
        narrow(least, most, dvec3(wide[i].x, dot(wide[i].yz, u), dot(wide[i].yz, v)));
    }
    dvec2 size = most - least;
    if (min(size.x, size.y) <= 0.0) return NOWHERE;
    if (k == 1) least.x += 2.0 * size.x;
    if (k == 2) least.y += 2.0 * size.y;
    return vec4(2.0 * (least.x * u + least.y * v) / picture - 1.0, 0.0, 1.0);
}

// Sets what the fragments ask; returns where corner k of what is drawn lies.
vec4 set_coverage(vec4 a, vec4 b, vec4 c, int k) {
    dvec3 v[3] = dvec3[3](from_eye(a), from_eye(b), from_eye(c));
    double turn = dot(v[0], cross(v[1], v[2])) < 0.0 ? -1.0 : 1.0;
    is_front = turn < 0.0 ? 1 : 0;
    int n_before = 0;
    bool is_before[3];
    for (int i = 0; i < 3; i++) {
        edge_line[i] = line_of_edge(v[i], v[(i + 1) % 3], turn);
        is_before[i] = dot(v[i], dvec3(row_forward)) > 0.0;
        n_before += int(is_before[i]);
    }
    if (n_before == 0) return NOWHERE;
    dvec3 wide[3] = edge_line, corner[3];
    for (int i = 0; i < 3; i++) wide[i].x += double(wider_px);
    if (!find_corners(wide, is_before, n_before, turn, corner)) {
        return corner_around(wide, is_front != 0 ? k : 2 - k);
    }
    dvec3 at = corner[k] / max(abs(corner[k].x), max(abs(corner[k].y), abs(corner[k].z)));
    return vec4(2.0 * at.yz / dvec2(size_px) - at.x, 0.0, at.x);
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
