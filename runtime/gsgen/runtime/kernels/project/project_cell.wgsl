// Project one cell: its depth, and the circle that bounds it in the image. Comparisons are phrased so
// that NaN is dropped.

//!include flatten
//!include circle
//!include cell_box
//!include exact_depth

struct ProjectedCell {
    key: u32,       // the depth; ABSENT if the cell is not visible
    low: u32,       // the depth's remainder, as bits that sort alike; ABSENT, too
    circle: vec4f,  // centre, radius, number of tiles
}

// Return the cell in row `own` of the bound cells, whose `eye` is set.
fn project_cell(own: u32) -> ProjectedCell {
    var result = ProjectedCell(ABSENT, ABSENT, vec4f(0.0));
    // Step 1: find the depth, exactly, because cells are sorted by it.
    let center = read_center(own);
    var at = page.linear * ((center.position - eye.at) - eye.rest);
    let distance = depth_of(at);
    let exact = exact_depth(center.position, distance);
    let depth = exact.x;
    at.z = select(depth, at.z, PANORAMA || FISHEYE);
    // Step 2: drop cells that are invisible, behind the near plane, or have no finite ellipse.
    let flat = flatten(at, distance, read_covariance(own));
    let is_there = depth > frame.near && depth <= LARGEST;
    if (!(flat.is_valid && is_there && center.opacity > 0.0 && center.opacity <= LARGEST)) {
        return result;
    }
    // Step 3: count the tiles of the circle around the ellipse; tiles of two copies count once.
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
        return result;
    }
    result.key = bitcast<u32>(depth);
    result.low = order_of(exact.y);
    result.circle = vec4f(flat.mean, radius, f32(tiles));
    return result;
}

// Return what the sum reads of a cell: its first Gaussian, their number, and factors.
fn span_of(first: u32, number: u32) -> vec4u {
    return vec4u(first, number, bitcast<vec2u>(vec2f(page.inverse_divisor, page.behind)));
}
