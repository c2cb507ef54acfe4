// Tally keys: count the sort keys of a page by their leading bits.
//
// One invocation per row. The host divides a scene into slabs by these counts.

//!include page
//!include slab

@group(0) @binding(2) var<storage, read_write> tally: array<atomic<u32>>;

@compute @workgroup_size(THREADS)
fn tally_keys(@builtin(global_invocation_id) invocation: vec3u) {
    if (invocation.x < page.capacity) {
        let key = keys[invocation.x];
        if (is_in_slab(key)) {
            atomicAdd(&tally[(key - slab.low) >> slab.shift], 1u);
        }
    }
}
