// Live counts: divide the live rows of a generator among its pages.
//
// A generator's count is known to the GPU alone. Below zero it means that no row is live.

@group(0) @binding(0) var<storage, read> total: array<i32>;
@group(0) @binding(1) var<storage, read_write> live: array<u32>;

@compute @workgroup_size(THREADS)
fn divide(@builtin(global_invocation_id) id: vec3u) {
    let page = id.x;
    if (page >= arrayLength(&live)) {
        return;
    }
    live[page] = u32(clamp(max(total[0], 0) - i32(page * PAGE_ROWS), 0, i32(PAGE_ROWS)));
}
