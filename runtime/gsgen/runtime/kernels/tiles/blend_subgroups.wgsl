// Blend like blend_tiles.wgsl, where a tile's invocations are one subgroup of LANES.
//
// Each invocation reads another splat and shares it with the others: software drivers make LANES
// reads even if all lanes read the same address.

//!include blend_tile
//!include tile_span

// Return a bit for each cell of a tile that a splat touches; all bits in a panorama, whose splats
// may be drawn twice.
fn cells_touched(tile: vec2u, shape: vec4f, weight: vec4f) -> u32 {
    if (PANORAMA) {
        return ~0u;
    }
    let ellipse = outline(shape.xy, vec3f(shape.zw, weight.x), weight.y, weight.w);
    let first = vec2f(tile * TILE) + 0.5 - ellipse.mean;  // the first pixel's centre
    var touched = 0u;
    for (var band = 0u; band < QUADS; band++) {
        let top = first.y + 4.0 * f32(band);
        if (top <= ellipse.half_height && top + 3.0 >= -ellipse.half_height) {
            let ends = extent(ellipse, vec2f(top, top + 3.0)) - first.x;
            for (var side = 0u; side < COLUMNS; side++) {
                let left = f32(side * LANES);
                if (ends.x <= left + f32(LANES - 1u) && ends.y >= left) {
                    touched |= 1u << (side * QUADS + band);
                }
            }
        }
    }
    return touched;
}

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(
    @builtin(workgroup_id) tile: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let range = begin_tile(tile.xy, local.xy);
    var open = ~0u;  // cells with a pixel that is not finished
    for (var first = range.x; first < range.y; first += LANES) {
        let own_id = pair_splats[min(first + lane, range.y - 1u)];
        let own_shape = shapes[own_id];
        let own_weight = weights[own_id];
        let own_color = colors[own_id];
        let own_cells = open & cells_touched(tile.xy, own_shape, own_weight);
        let count = min(LANES, range.y - first);
        for (var j = 0u; j < count; j++) {
            blend_splat(
                subgroupShuffle(own_id, j),
                subgroupShuffle(own_shape, j),
                subgroupShuffle(own_weight.xyz, j),
                subgroupShuffle(own_color.xyz, j),
                subgroupShuffle(own_cells, j),
            );
        }
        open = subgroupOr(open_cells());
        if (open == 0u) {
            break;
        }
    }
    end_tile();
}
