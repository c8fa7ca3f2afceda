// The sums of a frame as the screen shows them: the mean of its samples, gamma-encoded.
layout(binding = 0) uniform sampler2D radiance_of_pixel;

uniform float share;    // 1 / samples
uniform vec3 sky_less;  // taken from the sky: it is dark at night

layout(location = 0) out vec4 shown;

void main() {
    vec4 sum = share * texelFetch(radiance_of_pixel, ivec2(gl_FragCoord.xy), 0);
    vec3 value = clamp(sum.rgb - (1.0 - sum.a) * sky_less, 0.0, 1.0);
    vec3 low = 12.92 * value;
    vec3 high = 1.055 * pow(value, vec3(1.0 / 2.4)) - 0.055;
    shown = vec4(mix(high, low, lessThanEqual(value, vec3(0.0031308))), 1.0);
}
