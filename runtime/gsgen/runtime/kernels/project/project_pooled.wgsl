// Project, for a pool: convert the Gaussians of the slots that may be seen to splats with sort keys.
//
// One invocation per Gaussian; SLOT_ROWS / THREADS workgroups per slot of the list that
// `cull_slots` writes, which has the keys of all other slots made ABSENT.

//!include project_row
//!include seen_slots

@compute @workgroup_size(THREADS)
fn project_pooled(
    @builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) thread: u32
) {
    let slot = slot_of(workgroup.x);
    let row = row_of_slot(workgroup.x, thread);
    eye = slot_eye(slot);
    let opacity_scale = page.opacity_scale * slots[slot].fade;
    let own = slot * SLOT_ROWS + row;
    // If KEYS_ONLY, keys are an array of the page alone.
    project_row(own, select(page.base + own, own, KEYS_ONLY), row < slots[slot].live, opacity_scale);
}
