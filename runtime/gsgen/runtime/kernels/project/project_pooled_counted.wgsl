// Project, for a pool before a staged sort: as project_pooled.wgsl, and count the first digits of the
// sort keys.

//!include project_row
//!include seen_slots
//!include count_key

@compute @workgroup_size(THREADS)
fn project_pooled(
    @builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) thread: u32
) {
    let slot = slot_of(workgroup.x);
    let row = row_of_slot(workgroup.x, thread);
    eye = slot_eye(slot);
    let opacity_scale = page.opacity_scale * slots[slot].fade;
    let own = slot * SLOT_ROWS + row;
    let index = page.base + own;
    count_key(project_row(own, index, row < slots[slot].live, opacity_scale), index);
}
