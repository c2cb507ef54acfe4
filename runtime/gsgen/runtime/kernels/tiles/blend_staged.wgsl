// Blend like blend_tiles.wgsl, with splats that are read through workgroup memory, in batches.
//
// Each invocation reads another splat of a batch, and notes it for the cells of the tile that it
// touches. A cell has the pixels of LANES invocations, four above each other: as many as run in
// lockstep, so that they walk the same splats. Cells whose pixels are all finished take no part in
// the next batch, and the tile ends when no cell does.

//!include blend_tile
//!include cells_touched

const THREADS = TILE * TILE / 4u;
const BANDS = TILE / CELL_HEIGHT;
const WORDS = (THREADS + 31u) / 32u;  // of a mask with a bit for each splat of a batch

var<workgroup> batch_ids: array<u32, THREADS>;
var<workgroup> batch_shapes: array<vec4f, THREADS>;
var<workgroup> batch_weights: array<vec3f, THREADS>;
var<workgroup> batch_colors: array<vec3f, THREADS>;
var<workgroup> cell_splats: array<atomic<u32>, THREADS / LANES * WORDS>;  // by cell: the splats that touch it
var<workgroup> unfinished: atomic<u32>;  // a bit for each cell with an open pixel
var<workgroup> open: u32;                // those of the last batch

// Read the splat of a pair, and note it for all open cells that it touches.
fn read_splat(pair: u32, slot: u32, tile: vec2u, open_cells: u32) {
    let id = pair_splats[pair];
    let shape = vector_of(shapes[shape_at(id)]);
    let weight = vector_of(weights[weight_at(id)]);
    batch_ids[slot] = id;
    batch_shapes[slot] = shape;
    batch_weights[slot] = weight.xyz;
    batch_colors[slot] = vector_of(colors[id]).xyz;
    // Note the splat for the unfinished cells that it touches; a bit keeps its rank in the batch.
    var touched = open_cells & cells_touched(tile, shape, weight) & ((2u << (THREADS / LANES - 1u)) - 1u);
    while (touched != 0u) {
        let cell = firstTrailingBit(touched);
        touched &= touched - 1u;
        atomicOr(&cell_splats[cell * WORDS + slot / 32u], 1u << (slot % 32u));
    }
}

// Blend the splats of a batch that touch a cell, nearest first.
fn blend_batch(cell: u32) {
    for (var word = 0u; word < WORDS; word++) {
        var splats = atomicLoad(&cell_splats[cell * WORDS + word]);
        while (splats != 0u && is_open()) {
            let i = word * 32u + firstTrailingBit(splats);
            splats &= splats - 1u;
            blend_splat(batch_ids[i], batch_shapes[i], batch_weights[i], batch_colors[i]);
        }
    }
}

@compute @workgroup_size(THREADS)
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_index) thread: u32) {
    let cell = thread / LANES;
    let lane = vec2u(thread % CELL_WIDTH, thread % LANES / CELL_WIDTH);
    let first_lane = vec2u(cell / BANDS * CELL_WIDTH, cell % BANDS * (CELL_HEIGHT / 4u));
    let range = begin_tile(tile.xy, first_lane + lane);
    var open_before = ~0u;
    for (var first = range.x; first < range.y; first += THREADS) {
        // Step 1: clear the masks of the last batch.
        for (var word = thread; word < THREADS / LANES * WORDS; word += THREADS) {
            atomicStore(&cell_splats[word], 0u);
        }
        workgroupBarrier();
        // Step 2: read a batch.
        if (first + thread < range.y) {
            read_splat(first + thread, thread, tile.xy, open_before);
        }
        workgroupBarrier();
        // Step 3: blend it.
        blend_batch(cell);
        // Step 4: end the tile when all cells are finished.
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
