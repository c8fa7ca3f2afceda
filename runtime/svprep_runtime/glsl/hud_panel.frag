// One pixel of the panel on one of the window.
layout(binding = 0) uniform sampler2D panel;

in vec2 at_px;

layout(location = 0) out vec4 shown;

void main() {
    shown = texelFetch(panel, ivec2(at_px), 0);
}
