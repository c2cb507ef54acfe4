// Blend by weighted sums, as blend_wsr.wgsl does, where a tile's invocations are one subgroup of
// LANES: each invocation reads another cell, and another Gaussian of it, and all get them from there.

//!include sum_bindings

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(
    @builtin(workgroup_id) tile: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(subgroup_invocation_id) lane: u32,
) {
//!include sum_start
    var open = true;
    for (var first = range.x; first < range.y && open; first += LANES) {
        let own_span = spans[pair_cells[min(first + lane, range.y - 1u)]];
        let cells = min(LANES, range.y - first);
        for (var cell = 0u; cell < cells; cell++) {
            var still = ZERO;
//!include sum_enter
            open = subgroupAny(any(still > ZERO));
            if (!open) {
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
                let own_reach = select(0u, 1u, reaches(middle, own_shape, own_weight));
                for (var id = some; id < min(some + LANES, end); id++) {
                    if (subgroupShuffle(own_reach, id - some) == 0u) {
                        continue;
                    }
                    let weight = subgroupShuffle(own_weight, id - some);
                    let shape = subgroupShuffle(own_shape, id - some);
                    let color = subgroupShuffle(own_color.xyz, id - some);
//!include sum_splat
                }
            }
//!include sum_leave
        }
    }
//!include sum_finish
}
