// Project one Gaussian of a page for weighted sums.

//!include project_splat

@group(1) @binding(3) var<storage, read> cells: array<vec2f>;  // five pairs per cell; the second ends in its visibility

// Write the splat of row `own`, whose `eye` is set, at `index`, and return its key. A Gaussian that
// is not drawn has the key ABSENT and an empty splat, because no sort removes it.
fn project_weighted_row(own: u32, index: u32) -> u32 {
    var key = ABSENT;
    if (own < page.count) {
        let center = read_center(own);
        let offset = offset_from_eye(center.position);
        let at = page.linear * offset;
        let depth = depth_of(at);
        if (is_in_view(center.position, depth)) {
            let cell = (page.first_row + own) / page.per_cell - page.first_cell;
            var opacity = center.opacity * page.opacity_scale;
            opacity *= cells[5u * cell + 1u].y * (1.0 - depth * page.inverse_range);
            key = write_splat(own, index, offset, at, depth, depth, opacity);
        }
    }
    if (key == ABSENT) {
        write_empty(index);
    }
    return key;
}
