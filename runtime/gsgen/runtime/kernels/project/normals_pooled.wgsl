// Normals, for a pool: as normals.wgsl, relative to the origin of each row's slot.
//
// One invocation per Gaussian, over all slots: those that are not seen have the key ABSENT.

//!include normal_of_row
//!include slots

@compute @workgroup_size(THREADS)
fn find_normals(@builtin(global_invocation_id) invocation: vec3u) {
    eye = slot_eye(min(invocation.x, page.count - 1u) / SLOT_ROWS);
    write_normal(invocation.x);
}
