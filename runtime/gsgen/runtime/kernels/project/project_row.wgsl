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

// Return the length of a part of a buffer that has parts for both eyes: a multiple of EYE_ROWS.
fn eye_part() -> u32 {
    return (arrayLength(&keys) + EYE_ROWS - 1u) / EYE_ROWS * EYE_ROWS;
}

// Write the splat of the right eye after those of the left one, whose key is given; return the key of
// both. Parallel eyes see a centre at one depth: they differ in x alone.
fn write_right(
    own: u32, index: u32, offset: vec3f, at: vec3f, distance: f32, depth: f32, opacity: f32, left_key: u32
) -> u32 {
    let left_window = window;
    let right = eye_part() + index;
    let seen_at = vec3f(at.x - page.eye_distance, at.yz);
    let right_key = write_splat(own, right, offset - page.to_right_eye, seen_at, distance, depth, opacity);
    let key = min(left_key, right_key);
    if (key == ABSENT) {
        return key;
    }
    // The sorted splats are those of both eyes.
    if (left_key == ABSENT) {
        write_empty(index);
    }
    if (right_key == ABSENT) {
        write_empty(right);
    }
    if (WINDOWS) {
        lows[eye_part() + index] = select(left_window, 0u, left_key == ABSENT);
        lows[2u * eye_part() + index] = select(window, 0u, right_key == ABSENT);
    }
    return key;
}

// Write the splat of row `own`, whose `eye` is set, at `index`; if KEYS_ONLY, write its key alone. A
// row that is not live gets the key ABSENT and no splat. Return the key.
fn project_row(own: u32, index: u32, is_live: bool, opacity_scale: f32) -> u32 {
    var key = ABSENT;
    var low = 0u;
    if (is_live) {
        let center = read_center(own);
        let offset = offset_from_eye(center.position);
        var at = page.linear * offset;
        let distance = depth_of(at);
        let depth = exact_depth(center.position, distance);
        low = order_of(depth.y);
        at.z = select(depth.x, at.z, PANORAMA || FISHEYE);
        if (is_in_view(center.position, depth.x)) {
            let opacity = center.opacity * opacity_scale;
            key = write_splat(own, index, offset, at, distance, depth.x, opacity);
            if (EYES == 2u) {
                key = write_right(own, index, offset, at, distance, depth.x, opacity, key);
            }
        }
    }
    if (KEYS_ONLY) {
        keys[index] = slab_key(key, low, page.base + own);
    } else {
        keys[index] = key;
        lows[index] = select(low, ABSENT, key == ABSENT);
        if (WINDOWS && EYES == 1u && key != ABSENT) {
            lows[arrayLength(&lows) / 2u + index] = window;
        }
    }
    return key;
}
