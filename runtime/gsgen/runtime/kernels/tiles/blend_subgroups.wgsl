// Blend, as blend_tiles.wgsl does, where a tile's invocations are one subgroup of LANES.
//
// Each invocation reads another splat, and all get it from there: a driver on a CPU makes LANES
// reads of what its lanes read together, even where all of them read the same.

//!include blend_bindings
//!include tile_span

// Which cells of a tile a splat touches, one bit each; all of them in a panorama, whose splats
// may be there twice.
fn cells_touched(tile: vec2u, shape: vec4f, weight: vec4f) -> u32 {
    if (PANORAMA) {
        return ~0u;
    }
    let made = outline(shape.xy, vec3f(shape.zw, weight.x), weight.y, weight.w);
    let first = vec2f(tile * TILE) + 0.5 - made.mean;  // the first pixel's centre
    var cells = 0u;
//!repeat BAND QUADS
    {
        let top = first.y + 4.0 * f32(BANDu);
        if (top <= made.half_height && top + 3.0 >= -made.half_height) {
            let ends = extent(made, vec2f(top, top + 3.0)) - first.x;
//!repeat SIDE COLUMNS
            {
                let left = f32(SIDEu * LANES);
                if (ends.x <= left + f32(LANES - 1u) && ends.y >= left) {
                    cells |= 1u << (SIDEu * QUADS + BANDu);
                }
            }
//!end
        }
    }
//!end
    return cells;
}

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(
    @builtin(workgroup_id) tile: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(subgroup_invocation_id) lane: u32,
) {
//!include blend_start
    var live = ~0u;  // cells with a pixel that is not finished
    for (var first = range.x; first < range.y; first += LANES) {
        let own_id = pair_splats[min(first + lane, range.y - 1u)];
        let own_shape = shapes[own_id];
        let own_weight = weights[own_id];
        let own_color = colors[own_id];
        let own_cells = live & cells_touched(tile.xy, own_shape, own_weight);
        let count = min(LANES, range.y - first);
        for (var j = 0u; j < count; j++) {
            let id = subgroupShuffle(own_id, j);
            let shape = subgroupShuffle(own_shape, j);
            let weight = subgroupShuffle(own_weight.xyz, j);
            let color = subgroupShuffle(own_color.xyz, j);
            let cells = subgroupShuffle(own_cells, j);
//!include blend_splat
        }
        live = 0u;
//!repeat CELL CELLS
        live |= select(0u, 1u << CELLu, any(through_CELL > ZERO));
//!end
        live = subgroupOr(live);
        if (live == 0u) {
            break;
        }
    }
//!include blend_finish
}
