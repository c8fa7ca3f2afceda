// One vertex an entry; the geometry shader makes its volume.
flat out int entry_of_vertex;

uniform int first_entry;

void main() {
    entry_of_vertex = first_entry + gl_VertexID;
    gl_Position = vec4(0.0);
}
