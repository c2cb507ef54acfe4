// Blend like blend_tiles.wgsl, where a tile's invocations are one subgroup of LANES.
//
// Each invocation reads another splat and shares it with the others: software drivers make LANES
// reads even if all lanes read the same address.

//!include blend_tile
//!include cells_touched
//!include column_falloff

const CELL_WIDTH = LANES;
const CELL_HEIGHT = 4u;

fn shared_falloff(own: Falloff, lane: u32) -> Falloff {
    return Falloff(
        subgroupShuffle(own.mean, lane),
        subgroupShuffle(own.across, lane),
        subgroupShuffle(own.peak, lane),
        subgroupShuffle(own.bend, lane),
        subgroupShuffle(own.lean, lane),
        subgroupShuffle(own.change, lane),
    );
}

// Blend one splat over the cells that it touches, which have a bit of `touched` each. `column`: of
// the invocation's left cells.
fn blend_touched(splat: Falloff, column: f32, touched: u32, id: u32, depth: f32, color: vec3f) {
    let x = column + vec2f(0.0, f32(CELL_WIDTH)) - splat.mean.x;
    let exponent = splat.peak - splat.across * x * x;
    let y = splat.lean * x - splat.mean.y;
//!repeat CELL CELLS
    if ((touched & (1u << CELLu)) != 0u) {
        let first_y = y[CELLu / QUADS] + f32(CELLu % QUADS * 4u);
        blend_cell_CELL(column_opacity(splat, exponent[CELLu / QUADS], first_y), id, depth, color);
    }
//!end
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
        // Step 1: each lane reads another splat, and finds the cells that it touches.
        let own_id = pair_splats[min(first + lane, range.y - 1u)];
        let own_shape = vector_of(shapes[shape_at(own_id)]);
        var own_weight = vector_of(weights[weight_at(own_id)]);
        let own_color = vector_of(colors[own_id]);
        if (WINDOWS) {
            own_weight.w = own_color.w;  // so that fewer numbers are read
        }
        let own_cells = open & cells_touched(tile.xy, own_shape, own_weight);
        let own_falloff = falloff_of(tile.xy, own_shape, own_weight);
        // Step 2: blend the splats of all lanes, nearest first, over the pixels of each lane.
        let count = min(LANES, range.y - first);
        for (var j = 0u; j < count; j++) {
            let id = subgroupShuffle(own_id, j);
            let color = subgroupShuffle(own_color.xyz, j);
            let depth = subgroupShuffle(own_weight.z, j);
            if (MASKED) {
                let touched = subgroupShuffle(own_cells, j);
                blend_touched(shared_falloff(own_falloff, j), f32(local.x), touched, id, depth, color);
            } else {
                let weight = vec3f(subgroupShuffle(own_weight.xy, j), depth);
                blend_splat(id, subgroupShuffle(own_shape, j), weight, color);
            }
        }
        // Step 3: end the tile when no cell of any lane has an open pixel.
        open = subgroupOr(open_cells());
        if (open == 0u) {
            break;
        }
    }
    end_tile();
}
