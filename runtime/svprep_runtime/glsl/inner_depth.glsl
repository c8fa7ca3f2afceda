// Which of two faces that meet in an edge is nearer, decided inside of the edge.
//
//        .  centre of the pixel, a thousandth of a pixel outside
//       / \        both faces are drawn there, for a rasteriser moves corners to a grid,
//      /   \       and beyond their edge the planes lie in the wrong order
//
// So depth is taken at least INSIDE_PX within every edge of the face.

#ifdef WRITES_PLANE
flat out vec3 edge_line[3];  // how far inside of each edge, in pixels = x + y column + z row

void set_edges(vec4 a, vec4 b, vec4 c) {
    dvec3 v[3] = dvec3[3](from_eye(a), from_eye(b), from_eye(c));
    double turn = dot(v[0], cross(v[1], v[2])) < 0.0 ? -1.0 : 1.0;
    dvec3 corner = ray_of_sample();
    for (int k = 0; k < 3; k++) {
        dvec3 m = turn * cross(v[k], v[(k + 1) % 3]);
        dvec3 line = dvec3(dot(m, corner), dot(m, dvec3(ray_right)), dot(m, dvec3(ray_up)));
        double in_a_pixel = length(line.yz);
        edge_line[k] = in_a_pixel > 0.0 ? vec3(line / in_a_pixel) : vec3(1e9, 0.0, 0.0);
    }
}
#else
flat in vec3 edge_line[3];

const float INSIDE_PX = 1.0 / 128.0;  // twice what a grid of 1/256 moves a corner by

float inner_depth() {
    vec2 p = gl_FragCoord.xy;
    for (int n = 0; n < 2; n++) {  // a push from one edge may lead beyond another
        for (int k = 0; k < 3; k++) {
            precise float inside = edge_line[k].x + edge_line[k].y * p.x + edge_line[k].z * p.y;
            p += max(INSIDE_PX - inside, 0.0) * edge_line[k].yz;
        }
    }
    precise float z = depth_plane.x + depth_plane.y * p.x + depth_plane.z * p.y;
    return clamp(z, depth_range.x, depth_range.y);
}
#endif
