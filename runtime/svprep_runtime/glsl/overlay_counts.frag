// How many volumes hold what each pixel sees, as a colour.
layout(binding = 0) uniform usampler2D seen_of_pixel;
layout(binding = 1) uniform sampler2D count_of_pixel;

const int N_COLOURS = 8;

uniform vec4 palette[N_COLOURS + 1];  // of 1, 2, ... N_COLOURS and more; of negative counts

layout(location = 0) out vec4 shown;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int count = int(texelFetch(count_of_pixel, pixel, 0).r);
    if (count == 0 || texelFetch(seen_of_pixel, pixel, 0).r == 0u) discard;
    vec4 colour = palette[count < 0 ? N_COLOURS : min(count, N_COLOURS) - 1];
    shown = vec4(colour.rgb, 0.8);
}
