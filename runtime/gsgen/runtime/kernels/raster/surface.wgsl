// The corners of one triangle that covers a surface.

fn covering(corner: u32) -> vec4f {
    return vec4f(vec2f(vec2u(corner & 1u, corner >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}
