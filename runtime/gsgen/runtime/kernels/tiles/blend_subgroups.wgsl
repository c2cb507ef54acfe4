// Blend like blend_tiles.wgsl, where a tile's invocations are one subgroup of LANES.
//
// Each invocation reads another splat and shares it with the others: software drivers make LANES
// reads even if all lanes read the same address.

//!include blend_tile
//!include cells_touched

const CELL_WIDTH = LANES;
const CELL_HEIGHT = 4u;

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
        let own_shape = vector_of(shapes[shape_at(own_id)]);
        let own_weight = vector_of(weights[weight_at(own_id)]);
        let own_color = vector_of(colors[own_id]);
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
