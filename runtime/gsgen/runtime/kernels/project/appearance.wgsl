// Read the appearance of a Gaussian: RGB or SH coefficients, float16 or float32.

@group(1) @binding(2) var<storage, read> appearance: array<vec4u>;

// Return four successive numbers of row `own`. STRIDE is 0 if two rows share 16 bytes.
fn channels(own: u32, group: u32) -> vec4f {
    if (HALF_APPEARANCE && STRIDE == 0u) {
        let pair = appearance[own / 2u];
        let halves = select(pair.xy, pair.zw, own % 2u == 1u);
        return vec4f(unpack2x16float(halves.x), unpack2x16float(halves.y));
    }
    if (HALF_APPEARANCE) {
        let eight = appearance[own * STRIDE + group / 2u];
        let halves = select(eight.xy, eight.zw, group % 2u == 1u);
        return vec4f(unpack2x16float(halves.x), unpack2x16float(halves.y));
    }
    return bitcast<vec4f>(appearance[own * STRIDE + group]);
}

// Return four successive SH coefficients of red, green and blue.
fn coefficients(own: u32, quad: u32) -> array<vec3f, 4> {
    let a = channels(own, 3u * quad);
    let b = channels(own, 3u * quad + 1u);
    let c = channels(own, 3u * quad + 2u);
    return array<vec3f, 4>(a.xyz, vec3f(a.w, b.xy), vec3f(b.zw, c.x), c.yzw);
}
