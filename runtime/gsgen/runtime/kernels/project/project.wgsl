// Project: convert the Gaussians of one page to splats with sort keys.
//
// One invocation per Gaussian. A Gaussian that is not drawn gets the key ABSENT and no splat.

//!include project_splat
//!include exact_depth

@group(0) @binding(5) var<storage, read_write> lows: array<u32>;  // depth remainders, as bits that sort alike

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity) {
        return;
    }
    let index = page.base + own;
    var key = ABSENT;
    var low = 0u;
    if (own < page.count) {
        let center = read_center(own);
        var at = page.linear * offset_from_eye(center.position);
        let distance = depth_of(at);
        let depth = exact_depth(center.position, distance);
        low = order_of(depth.y);
        at.z = select(depth.x, at.z, PANORAMA);
        if (is_in_view(center.position, depth.x)) {
            let opacity = center.opacity * page.opacity_scale;
            key = write_splat(own, index, center.position, at, distance, depth.x, opacity);
        }
    }
    keys[index] = key;
    lows[index] = select(low, ABSENT, key == ABSENT);
}
