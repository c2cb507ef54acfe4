// Blend, as blend_tiles.wgsl does, where a tile's invocations are one subgroup of LANES.
//
// Each invocation reads another splat, and all get it from there: a driver on a CPU makes LANES
// reads of what its lanes read together, even where all of them read the same.

//!include blend_bindings

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(
    @builtin(workgroup_id) tile: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(subgroup_invocation_id) lane: u32,
) {
//!include blend_start
    for (var first = range.x; first < range.y; first += LANES) {
        let own_id = pair_splats[min(first + lane, range.y - 1u)];
        let own_shape = shapes[own_id];
        let own_weight = weights[own_id];
        let own_color = colors[own_id];
        let count = min(LANES, range.y - first);
        for (var j = 0u; j < count; j++) {
            let id = subgroupShuffle(own_id, j);
            let shape = subgroupShuffle(own_shape, j);
            let weight = subgroupShuffle(own_weight.xyz, j);
            let color = subgroupShuffle(own_color.xyz, j);
//!include blend_splat
        }
        var most = ZERO;
//!repeat CELL CELLS
        most = max(most, through_CELL);
//!end
        if (!subgroupAny(any(most > ZERO))) {
            break;
        }
    }
//!include blend_finish
}
