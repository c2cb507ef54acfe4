// What covers a surface, and the curve of its bytes (IEC 61966-2-1).

fn covering(corner: u32) -> vec4f {
    return vec4f(vec2f(vec2u(corner & 1u, corner >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

fn srgb_of_linear(color: vec3f) -> vec3f {
    let curve = 1.055 * pow(color, vec3f(1.0 / 2.4)) - 0.055;
    return select(curve, 12.92 * color, color <= vec3f(0.0031308));
}
