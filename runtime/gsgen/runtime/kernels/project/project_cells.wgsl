// Project cells: compute the depth and the circle of each cell of one set, and count its tiles.
//
// One invocation per cell. A cell that is not visible gets the key ABSENT.

//!include project_cell

@group(0) @binding(1) var<storage, read_write> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> circles: array<vec4f>;  // centre, radius, number of tiles
@group(0) @binding(3) var<storage, read_write> spans: array<vec4u>;    // first Gaussian, number, 1 / divisor, weight of the background
@group(0) @binding(4) var<storage, read> gaussian_keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> lows: array<u32>;       // depth remainders, as bits that sort alike

fn count_drawn(first: u32) {
    var drawn = 0u;
    for (var id = first; id < first + page.per_cell; id++) {
        drawn += select(0u, 1u, gaussian_keys[id] != ABSENT);
    }
    atomicAdd(&counts[DRAWN], drawn);
}

@compute @workgroup_size(THREADS)
fn project_cells(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity) {
        return;
    }
    let index = page.base + own;
    var cell = ProjectedCell(ABSENT, ABSENT, vec4f(0.0));
    eye = page_eye();
    if (own < page.count) {
        cell = project_cell(own);
    }
    if (cell.key != ABSENT) {
        let first = page.first_gaussian + own * page.per_cell;
        circles[index] = cell.circle;
        spans[index] = span_of(first, page.per_cell);
        count_drawn(first);
    }
    keys[index] = cell.key;
    lows[index] = cell.low;
}
