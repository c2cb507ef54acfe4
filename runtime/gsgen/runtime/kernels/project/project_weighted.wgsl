// Project, for weighted sums: convert the Gaussians of one page to splats that are not sorted.
//
// One invocation per Gaussian. A Gaussian that is not drawn gets the key ABSENT and an empty splat,
// because no sort removes it.

//!include project_splat

@group(1) @binding(3) var<storage, read> cells: array<vec2f>;  // five pairs per cell; the second ends in its visibility

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity) {
        return;
    }
    let index = page.base + own;
    var key = ABSENT;
    eye = page_eye();
    if (own < page.count) {
        let center = read_center(own);
        let at = page.linear * offset_from_eye(center.position);
        let depth = depth_of(at);
        if (is_in_view(center.position, depth)) {
            let cell = (page.first_row + own) / page.per_cell;
            var opacity = center.opacity * page.opacity_scale;
            opacity *= cells[5u * cell + 1u].y * (1.0 - depth * page.inverse_range);
            key = write_splat(own, index, center.position, at, depth, depth, opacity);
        }
    }
    keys[index] = key;
    if (key == ABSENT) {
        weights[index] = quad_of(vec4f(0.0, -LARGEST, 0.0, 0.0));
    }
}
