// The cells of a slab. `find_keys` gives every Gaussian of a page the key of its cell, by which slabs
// are chosen; `place_cells` writes the cells whose first Gaussian in the slab is in the page.
//
// One invocation per Gaussian. A slab holds whole cells, except where one cell has more Gaussians than
// a slab: then it holds some of them, and nothing else.

//!include project_cell

@group(0) @binding(1) var<storage, read_write> keys: array<u32>;       // by row of the page, or by slot of the slab
@group(0) @binding(2) var<storage, read_write> circles: array<vec4f>;  // by slot: centre, radius, number of tiles
@group(0) @binding(3) var<storage, read_write> spans: array<vec4u>;    // by slot: first Gaussian, number, 1 / divisor, weight of the background
@group(0) @binding(4) var<storage, read_write> lows: array<u32>;       // by slot: depth remainders, as bits that sort alike
@group(0) @binding(5) var<storage, read> places: array<u32>;           // by row: the index of its splat, or ABSENT

// Return the key of a Gaussian in the present division: the depth of its cell, the remainder of that
// depth, the first Gaussian of the cell, or the Gaussian itself.
fn key_of(cell: ProjectedCell, first: u32, index: u32) -> u32 {
    if (frame.rank == 0u || cell.key == ABSENT) {
        return cell.key;
    }
    if (frame.rank == 3u) {
        return select(ABSENT, index, first == frame.tied_key);
    }
    let is_tied = cell.key == frame.tied_key && (frame.rank == 1u || cell.low == frame.tied_low);
    return select(ABSENT, select(first, cell.low, frame.rank == 1u), is_tied);
}

@compute @workgroup_size(THREADS)
fn find_keys(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity) {
        return;
    }
    let row = page.first_row + own;
    let index = page.base + own;
    var key = ABSENT;
    eye = page_eye();
    if (row / page.per_cell < page.live_cells) {
        let cell = project_cell(row / page.per_cell - page.first_cell);
        key = key_of(cell, index - row % page.per_cell, index);
    }
    keys[own] = key;
}

@compute @workgroup_size(THREADS)
fn place_cells(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.capacity || places[own] == ABSENT) {
        return;
    }
    let place = places[own];
    let row = page.first_row + own;
    if (place > 0u && row % page.per_cell != 0u) {
        return;
    }
    eye = page_eye();
    let cell = project_cell(row / page.per_cell - page.first_cell);
    let number = select(page.per_cell, frame.tied_low, frame.rank == 3u);
    let slot = place / page.per_slot;
    keys[slot] = cell.key;
    lows[slot] = cell.low;
    circles[slot] = cell.circle;
    spans[slot] = span_of(place, number);
    // Larger cells than the smallest leave slots empty.
    for (var empty = slot + 1u; empty < (place + number) / page.per_slot; empty++) {
        keys[empty] = ABSENT;
        lows[empty] = ABSENT;
    }
}
