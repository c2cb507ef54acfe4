// Find which cells of a tile a splat touches; a cell has CELL_WIDTH × CELL_HEIGHT pixels.

//!include tile_span

// Return a bit for each touched cell, those of the left column of cells first; all bits in a
// panorama, whose splats may be drawn twice.
fn cells_touched(tile: vec2u, shape: vec4f, weight: vec4f) -> u32 {
    if (PANORAMA) {
        return ~0u;
    }
    let ellipse = outline(shape.xy, vec3f(shape.zw, weight.x), weight.y, weight.w);
    let first = vec2f(tile * TILE) + 0.5 - ellipse.mean;  // the first pixel's centre
    let height = f32(CELL_HEIGHT - 1u);
    var touched = 0u;
    for (var band = 0u; band < TILE / CELL_HEIGHT; band++) {
        let top = first.y + f32(band * CELL_HEIGHT);
        // A band is touched if rows of the ellipse are in it, and a cell if their columns reach it.
        if (top <= ellipse.half_height && top + height >= -ellipse.half_height) {
            let ends = extent(ellipse, vec2f(top, top + height)) - first.x;
            for (var side = 0u; side < TILE / CELL_WIDTH; side++) {
                let left = f32(side * CELL_WIDTH);
                if (ends.x <= left + f32(CELL_WIDTH - 1u) && ends.y >= left) {
                    touched |= 1u << (side * (TILE / CELL_HEIGHT) + band);
                }
            }
        }
    }
    return touched;
}
