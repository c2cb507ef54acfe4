// A vector of four floats in memory, in two words of 64 bits.
//
// `source` of shader.py includes this file in place of words.wgsl if `wide_words`: software drivers read
// and write number by number for each invocation, and so in half as many steps.

alias Quad = vec2<u64>;

fn vector_of(quad: Quad) -> vec4f {
    let first = vec2u(u32(quad.x), u32(quad.x >> 32u));
    let second = vec2u(u32(quad.y), u32(quad.y >> 32u));
    return bitcast<vec4f>(vec4u(first, second));
}

fn quad_of(vector: vec4f) -> Quad {
    let bits = bitcast<vec4u>(vector);
    return vec2<u64>(u64(bits.x) | (u64(bits.y) << 32u), u64(bits.z) | (u64(bits.w) << 32u));
}
