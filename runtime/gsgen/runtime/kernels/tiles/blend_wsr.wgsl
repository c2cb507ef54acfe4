// Blend by weighted sums: sum the Gaussians of each cell, and blend a tile's cells front to back.
//
// One workgroup per tile, divided as in blend_tiles.wgsl.
//
// With PICK a pixel has no colour, but Σ w z, the median depth (where half of the light is gone),
// the index of the Gaussian that covers most in the cell at that depth, and alpha.

//!include sum_tile

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let range = begin_tile(tile.xy, local.xy);
    for (var pair = range.x; pair < range.y; pair++) {
        if (!any(enter_cell() > ZERO)) {
            break;
        }
        let span = spans[pair_cells[pair]];
        let factors = bitcast<vec2f>(span.zw);
        for (var id = span.x; id < span.x + span.y; id++) {
            let weight = weights[id];
            let shape = shapes[id];
            if (reaches_tile(shape, weight)) {
                add_splat(id, shape, weight, colors[id].xyz, factors);
            }
        }
        leave_cell();
    }
    end_tile();
}
