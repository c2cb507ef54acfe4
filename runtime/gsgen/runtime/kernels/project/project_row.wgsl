// Project one Gaussian of a page, and write its splat, its sort key and its depth remainder.

//!include project_splat
//!include exact_depth

@group(0) @binding(5) var<storage, read_write> lows: array<u32>;  // depth remainders, as bits that sort alike; if WINDOWS, then the words of tile_window.wgsl

// Return the sort key of a splat; in a frame whose slabs divide the splats of one depth, its rank
// among them: the remainder of the depth, or the row where remainders are equal, too.
fn slab_key(key: u32, low: u32, row: u32) -> u32 {
    if (frame.rank == 0u) {
        return key;
    }
    let is_tied = key == frame.tied_key && (frame.rank == 1u || low == frame.tied_low);
    return select(ABSENT, select(row, low, frame.rank == 1u), is_tied);
}

// Write the splat of row `own`, whose `eye` is set, at `index`; if KEYS_ONLY, write its key alone. A
// row that is not live gets the key ABSENT and no splat. Return the key.
fn project_row(own: u32, index: u32, is_live: bool, opacity_scale: f32) -> u32 {
    var key = ABSENT;
    var low = 0u;
    if (is_live) {
        let center = read_center(own);
        var at = page.linear * offset_from_eye(center.position);
        let distance = depth_of(at);
        let depth = exact_depth(center.position, distance);
        low = order_of(depth.y);
        at.z = select(depth.x, at.z, PANORAMA || FISHEYE);
        if (is_in_view(center.position, depth.x)) {
            let opacity = center.opacity * opacity_scale;
            key = write_splat(own, index, center.position, at, distance, depth.x, opacity);
        }
    }
    if (KEYS_ONLY) {
        keys[index] = slab_key(key, low, page.base + own);
    } else {
        keys[index] = key;
        lows[index] = select(low, ABSENT, key == ABSENT);
        if (WINDOWS && key != ABSENT) {
            lows[arrayLength(&lows) / 2u + index] = window;
        }
    }
    return key;
}
