// Blend by weighted sums: composite each tile's cells, front to back, whose Gaussians are summed.
//
// One workgroup per tile, invocations as in blend_tiles.wgsl. `through` is what light still passes
// a pixel. Within a cell every Gaussian is weighed by what passed before the cell, `open`, so the
// order of a cell's Gaussians does not count. Once less than FINISHED is left, further cells are
// left out, and so is what is behind.
//
// `total` is Σ w, `behind` Σ w b with b the weight of what is behind, as the Gaussian's set has it.
// With PICK the image is not of colours: it has Σ w z, the depth where half of the light is gone,
// the index of the Gaussian that covered most in that cell, and alpha.

//!include sum_bindings

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) local: vec3u) {
//!include sum_start
    for (var pair = range.x; pair < range.y; pair++) {
        var still = ZERO;
//!include sum_enter
        if (!any(still > ZERO)) {
            break;
        }
        let span = spans[pair_cells[pair]];
        let factors = bitcast<vec2f>(span.zw);
        for (var id = span.x; id < span.x + span.y; id++) {
            let weight = weights[id];
            let shape = shapes[id];
            if (!reaches(middle, shape, weight)) {
                continue;
            }
            let color = colors[id];
//!include sum_splat
        }
//!include sum_leave
    }
//!include sum_finish
}
