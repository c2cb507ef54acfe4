// A vector of four floats in memory, as it is read.

alias Quad = vec4f;

fn vector_of(quad: Quad) -> vec4f {
    return quad;
}
