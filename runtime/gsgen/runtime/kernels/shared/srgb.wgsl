// The transfer function of sRGB (IEC 61966-2-1).

fn srgb_of_linear(color: vec3f) -> vec3f {
    let curved = 1.055 * pow(max(color, vec3f(0.0)), vec3f(1.0 / 2.4)) - 0.055;
    return select(curved, 12.92 * color, color <= vec3f(0.0031308));
}
