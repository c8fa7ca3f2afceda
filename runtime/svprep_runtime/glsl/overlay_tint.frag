// Sides and caps of volumes as glass: one tint for each side that is seen.
uniform vec4 front;
uniform vec4 back;

layout(location = 0) out vec4 shown;

void main() {
    shown = gl_FrontFacing ? front : back;
}
