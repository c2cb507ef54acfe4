// List ranges: convert the counters of list_tiles.wgsl to indices in the lists of all tiles.
//
// One invocation per tile. `total` sums the counters of a tile; the totals are scanned (scan.wgsl);
// `begin` writes the range of the tile's list, and in each counter the index of its first splat.

//!include frame

@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> counters: array<vec4u>;  // of four invocations
@group(0) @binding(3) var<storage, read_write> totals: array<u32>;
@group(0) @binding(4) var<storage, read_write> ranges: array<vec2u>;

const QUADS = RUNS / 4u;  // of a workgroup of list_tiles.wgsl

@compute @workgroup_size(THREADS)
fn total(@builtin(global_invocation_id) invocation: vec3u) {
    let tiles = image_tiles().x * image_tiles().y;
    if (invocation.x >= tiles) {
        return;
    }
    // The counters of a tile are those of all runs, four beside each other.
    var sum = vec4u(0u);
    for (var group = 0u; group < arrayLength(&counters); group += QUADS * tiles) {
        for (var quad = 0u; quad < QUADS; quad++) {
            sum += counters[group + invocation.x * QUADS + quad];
        }
    }
    totals[invocation.x] = sum.x + sum.y + sum.z + sum.w;
}

@compute @workgroup_size(THREADS)
fn begin(@builtin(global_invocation_id) invocation: vec3u) {
    let tiles = image_tiles().x * image_tiles().y;
    if (invocation.x >= tiles) {
        return;
    }
    // Step 1: a counter becomes the number of splats before it, in nearer runs: lists stay sorted.
    let first = totals[invocation.x];
    var index = first;
    for (var group = 0u; group < arrayLength(&counters); group += QUADS * tiles) {
        for (var quad = 0u; quad < QUADS; quad++) {
            let quad_index = group + invocation.x * QUADS + quad;
            let amounts = counters[quad_index];
            let second = index + amounts.x;
            let third = second + amounts.y;
            let fourth = third + amounts.z;
            counters[quad_index] = vec4u(index, second, third, fourth);
            index = fourth + amounts.w;
        }
    }
    // Step 2: splats beyond the capacity are not listed, and the frame is drawn again with a larger one.
    let capacity = vec2u(counts[PAIR_CAPACITY]);
    ranges[invocation.x] = select(vec2u(0u), min(vec2u(first, index), capacity), index > first);
}
