// Blend by weighted sums like blend_wsr.wgsl, where a tile's invocations are one subgroup of LANES:
// each invocation reads another cell and another Gaussian, and shares them with the others.

//!include sum_tile

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(
    @builtin(workgroup_id) tile: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let range = begin_tile(tile.xy, local.xy);
    var is_open = true;
    for (var first = range.x; first < range.y && is_open; first += LANES) {
        let own_span = spans[pair_cells[min(first + lane, range.y - 1u)]];
        let cells = min(LANES, range.y - first);
        for (var cell = 0u; cell < cells; cell++) {
            is_open = subgroupAny(any(enter_cell() > ZERO));
            if (!is_open) {
                break;
            }
            let span = subgroupShuffle(own_span, cell);
            let factors = bitcast<vec2f>(span.zw);
            let end = span.x + span.y;
            for (var some = span.x; some < end; some += LANES) {
                let own_id = min(some + lane, end - 1u);
                let own_weight = weights[own_id];
                let own_shape = shapes[own_id];
                let own_color = colors[own_id];
                let own_reach = select(0u, 1u, reaches_tile(own_shape, own_weight));
                for (var id = some; id < min(some + LANES, end); id++) {
                    let source = id - some;
                    if (subgroupShuffle(own_reach, source) == 0u) {
                        continue;
                    }
                    let weight = subgroupShuffle(own_weight, source);
                    let shape = subgroupShuffle(own_shape, source);
                    let color = subgroupShuffle(own_color.xyz, source);
                    add_splat(id, shape, weight, color, factors);
                }
            }
            leave_cell();
        }
    }
    end_tile();
}
