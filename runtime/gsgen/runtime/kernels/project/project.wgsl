// Project: convert the Gaussians of one page to splats with sort keys.
//
// One invocation per Gaussian. A Gaussian that is not drawn gets the key ABSENT and no splat.

//!include project_row

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity) {
        return;
    }
    eye = page_eye();
    // If KEYS_ONLY, keys are an array of the page alone.
    project_row(own, select(page.base + own, own, KEYS_ONLY), own < page.count, page.opacity_scale);
}
