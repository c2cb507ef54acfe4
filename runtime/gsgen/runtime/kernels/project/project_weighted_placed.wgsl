// Project, for a slab of weighted sums: convert the Gaussians of a page whose cells are in the slab,
// and count those that are drawn.
//
// One invocation per Gaussian.

//!include project_weighted_row

@group(0) @binding(1) var<storage, read_write> counts: array<atomic<u32>>;  // in place of keys
@group(1) @binding(4) var<storage, read> places: array<u32>;                // by row: the index of its splat, or ABSENT

var<workgroup> drawn: atomic<u32>;

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u, @builtin(local_invocation_index) thread: u32) {
    let own = invocation.x;
    if (thread == 0u) {
        atomicStore(&drawn, 0u);
    }
    workgroupBarrier();
    eye = page_eye();
    if (own < page.capacity) {
        let place = places[own];
        if (place != ABSENT && project_weighted_row(own, place) != ABSENT) {
            atomicAdd(&drawn, 1u);
        }
    }
    workgroupBarrier();
    if (thread == 0u) {
        let sum = atomicLoad(&drawn);
        if (sum > 0u) {
            atomicAdd(&counts[DRAWN], sum);
        }
    }
}
