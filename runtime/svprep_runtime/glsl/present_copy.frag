// A finished picture, each of its pixels on `enlarged` by `enlarged` pixels.
layout(binding = 0) uniform sampler2D picture;

uniform int enlarged;

layout(location = 0) out vec4 shown;

void main() {
    // Opaque: a desktop must not shine through the window.
    shown = vec4(texelFetch(picture, ivec2(gl_FragCoord.xy) / enlarged, 0).rgb, 1.0);
}
