// Project, for a slab: convert the Gaussians of a page that are in the slab to splats.
//
// One invocation per Gaussian.

//!include project_row

@group(1) @binding(3) var<storage, read> places: array<u32>;  // by row: the index of its splat, or ABSENT

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity || places[own] == ABSENT) {
        return;
    }
    eye = page_eye();
    project_row(own, places[own], own < page.count, page.opacity_scale);
}
