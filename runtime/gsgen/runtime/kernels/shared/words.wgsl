// A vector of four floats in memory.

alias Quad = vec4f;

fn vector_of(quad: Quad) -> vec4f {
    return quad;
}

fn quad_of(vector: vec4f) -> Quad {
    return vector;
}
