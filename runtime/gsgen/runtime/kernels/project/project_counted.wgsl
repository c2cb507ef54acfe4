// Project, before a staged sort: as project.wgsl, and count the first digits of the sort keys.

//!include project_row
//!include count_key

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity) {
        return;
    }
    eye = page_eye();
    let index = page.base + own;
    count_key(project_row(own, index, own < page.count, page.opacity_scale), index);
}
