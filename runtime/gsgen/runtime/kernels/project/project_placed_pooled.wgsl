// Project, for a slab: convert the Gaussians of a pool's page that are in the slab to splats.
//
// One invocation per Gaussian, over all slots: those that are not seen have no splats in a slab.

//!include project_row
//!include slots

@group(1) @binding(4) var<storage, read> places: array<u32>;  // by row: the index of its splat, or ABSENT

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity || places[own] == ABSENT) {
        return;
    }
    let slot = own / SLOT_ROWS;
    eye = slot_eye(slot);
    let opacity_scale = page.opacity_scale * slots[slot].fade;
    project_row(own, places[own], own % SLOT_ROWS < slots[slot].live, opacity_scale);
}
