// A panel of text: two triangles over its pixels, row 0 at the top.
uniform vec4 place_px;  // left, top, width, height
uniform vec2 size_px;   // of the window

out vec2 at_px;

void main() {
    vec2 corner = vec2[6](vec2(0, 0), vec2(1, 0), vec2(1, 1), vec2(0, 0), vec2(1, 1), vec2(0, 1))[gl_VertexID];
    at_px = corner * place_px.zw;
    vec2 where = (place_px.xy + at_px) / size_px;
    gl_Position = vec4(2.0 * where.x - 1.0, 1.0 - 2.0 * where.y, 0.0, 1.0);
}
