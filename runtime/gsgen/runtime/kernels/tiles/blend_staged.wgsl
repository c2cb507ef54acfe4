// Blend like blend_tiles.wgsl, for GPUs: splats are read through workgroup memory, in batches.
//
// Each invocation reads another splat of a batch, and finds which cells of the tile it touches. A
// cell has the pixels of LANES invocations, four above each other: as many as most GPUs run in
// lockstep, so that they skip a splat together. Cells whose pixels are all finished take no part in
// the next batch, and the tile ends when no cell does.

//!include blend_tile
//!include cells_touched

const CELL_WIDTH = 16u;
const CELL_HEIGHT = 8u;
const THREADS = TILE * TILE / 4u;
const BANDS = TILE / CELL_HEIGHT;

var<workgroup> batch_ids: array<u32, THREADS>;
var<workgroup> batch_cells: array<u32, THREADS>;      // a bit for each touched cell
var<workgroup> batch_shapes: array<vec4f, THREADS>;
var<workgroup> batch_weights: array<vec3f, THREADS>;
var<workgroup> batch_colors: array<vec3f, THREADS>;
var<workgroup> unfinished: atomic<u32>;               // a bit for each cell with an open pixel
var<workgroup> open: u32;                             // those of the last batch

@compute @workgroup_size(THREADS)
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_index) thread: u32) {
    let cell = thread / LANES;
    let lane = vec2u(thread % CELL_WIDTH, thread % LANES / CELL_WIDTH);
    let first_lane = vec2u(cell / BANDS * CELL_WIDTH, cell % BANDS * (CELL_HEIGHT / 4u));
    let range = begin_tile(tile.xy, first_lane + lane);
    var open_before = ~0u;
    for (var first = range.x; first < range.y; first += THREADS) {
        // Step 1: read a batch.
        let pair = first + thread;
        if (pair < range.y) {
            let id = pair_splats[pair];
            let shape = shapes[shape_at(id)];
            let weight = weights[weight_at(id)];
            batch_ids[thread] = id;
            batch_cells[thread] = open_before & cells_touched(tile.xy, shape, weight);
            batch_shapes[thread] = shape;
            batch_weights[thread] = weight.xyz;
            batch_colors[thread] = colors[id].xyz;
        }
        workgroupBarrier();
        // Step 2: blend its splats over the cells that they touch, nearest first.
        let count = min(THREADS, range.y - first);
        for (var i = 0u; i < count && is_open(); i++) {
            if ((batch_cells[i] & (1u << cell)) != 0u) {
                blend_splat(batch_ids[i], batch_shapes[i], batch_weights[i], batch_colors[i], 0u);
            }
        }
        // Step 3: end the tile when all cells are finished.
        if (is_open()) {
            atomicOr(&unfinished, 1u << cell);
        }
        workgroupBarrier();
        if (thread == 0u) {
            open = atomicExchange(&unfinished, 0u);
        }
        open_before = workgroupUniformLoad(&open);
        if (open_before == 0u) {
            break;
        }
    }
    end_tile();
}
