// Normals: the shortest axis of each drawn Gaussian of one page, turned towards the camera.
//
// One invocation per Gaussian.

//!include normal_of_row

@compute @workgroup_size(THREADS)
fn find_normals(@builtin(global_invocation_id) invocation: vec3u) {
    eye = page_eye();
    write_normal(invocation.x);
}
