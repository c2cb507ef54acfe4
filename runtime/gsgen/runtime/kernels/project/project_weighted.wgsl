// Project, for weighted sums: convert the Gaussians of one page to splats that are not sorted.
//
// One invocation per Gaussian.

//!include project_weighted_row

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity) {
        return;
    }
    let index = page.base + own;
    eye = page_eye();
    keys[index] = project_weighted_row(own, index);
}
