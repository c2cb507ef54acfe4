// Where the two vectors of a splat are: in one record of 32 bytes, which a GPU reads at once, or in
// two arrays, of which each binding may hold twice as many. With RECORDS both bindings that kernels
// read are the same buffer.

fn shape_at(splat: u32) -> u32 {
    return select(splat, 2u * splat, RECORDS);
}

fn weight_at(splat: u32) -> u32 {
    return select(splat, 2u * splat + 1u, RECORDS);
}
