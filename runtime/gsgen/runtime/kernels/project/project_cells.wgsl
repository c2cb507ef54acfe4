// Project cells: compute the depth and the circle of each cell of one set, and count its tiles.
//
// One invocation per cell. A cell that is not visible gets the key ABSENT. Comparisons are phrased
// so that NaN is dropped.

//!include flatten
//!include circle
//!include cell_box
//!include exact_depth

@group(0) @binding(1) var<storage, read_write> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> circles: array<vec4f>;  // centre, radius, number of tiles
@group(0) @binding(3) var<storage, read_write> spans: array<vec4u>;    // first Gaussian, number, 1 / divisor, weight of the background
@group(0) @binding(4) var<storage, read> gaussian_keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> lows: array<u32>;       // depth remainders, as bits that sort alike

var<private> low: u32;  // the cell's depth remainder

fn count_drawn(first: u32) {
    var drawn = 0u;
    for (var id = first; id < first + page.per_cell; id++) {
        drawn += select(0u, 1u, gaussian_keys[id] != ABSENT);
    }
    atomicAdd(&counts[DRAWN], drawn);
}

fn cell_key(own: u32, index: u32) -> u32 {
    let center = read_center(own);
    var at = page.linear * ((center.position - eye.at) - eye.rest);
    let distance = depth_of(at);
    let exact = exact_depth(center.position, distance);
    let depth = exact.x;
    low = order_of(exact.y);
    at.z = select(depth, at.z, PANORAMA);
    let flat = flatten(at, distance, read_covariance(own));
    let is_there = depth > frame.near && depth <= LARGEST;
    if (!(flat.is_valid && is_there && center.opacity > 0.0 && center.opacity <= LARGEST)) {
        return ABSENT;
    }
    let radius = circle(flat.scaled, flat.determinant, flat.unit, CELL_REACH);
    var tiles = 0u;
    var listed = 0u;
    for (var copy = FIRST_COPY; copy < FIRST_COPY + COPIES; copy++) {
        let box = box_of(flat.mean, radius, copy);
        let columns = max(box.z, listed) - max(box.x, listed);
        tiles += columns * (box.w - box.y);
        listed = max(box.z, listed);
    }
    if (tiles == 0u) {
        return ABSENT;
    }
    circles[index] = vec4f(flat.mean, radius, f32(tiles));
    let first = page.first_gaussian + own * page.per_cell;
    spans[index] = vec4u(first, page.per_cell, bitcast<vec2u>(vec2f(page.inverse_divisor, page.behind)));
    count_drawn(first);
    return bitcast<u32>(depth);
}

@compute @workgroup_size(THREADS)
fn project_cells(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity) {
        return;
    }
    let index = page.base + own;
    var key = ABSENT;
    eye = page_eye();
    if (own < page.count) {
        key = cell_key(own, index);
    }
    keys[index] = key;
    lows[index] = select(low, ABSENT, key == ABSENT);
}
