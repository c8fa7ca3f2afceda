// For geometry shaders that fetch their own vertices.
void main() {
    gl_Position = vec4(0.0);
}
