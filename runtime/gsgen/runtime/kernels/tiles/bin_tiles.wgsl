// Bin: list the tiles that each splat touches, nearest splat first, and count the tiles' first digits.
//
// A workgroup's pairs are neighbours, mostly of one or two blocks of the sort. It counts the digits of
// two blocks in its own memory, and adds each sum to the histogram: several times fewer atomic
// additions there than pairs.

//!include first_digits
//!include runs
//!include splat_record
//!include tile_span
//!include words

@group(0) @binding(7) var<storage, read> shapes: array<Quad>;
@group(0) @binding(8) var<storage, read> weights: array<Quad>;
// `measure` has another buffer here: no more than eight storage buffers can be bound everywhere.
@group(0) @binding(3) var<storage, read_write> histogram: array<atomic<u32>>;

const NEAR = 2u;  // blocks whose digits are summed in workgroup memory

var<workgroup> digit_sums: array<atomic<u32>, NEAR * DIGITS>;
var<private> first_block: u32;  // of the workgroup's pairs

// Count the tiles of the pairs from `first` to before `end`: neighbours in a row, from `tile` on.
fn count_tiles(tile: u32, first: u32, end: u32) {
    let listed = min(end, counts[PAIR_CAPACITY]);
    for (var pair = first; pair < listed; pair++) {
        let value = (tile + pair - first) % DIGITS;
        let number = pair / SORT_BLOCK - first_block;
        if (number < NEAR) {
            atomicAdd(&digit_sums[number * DIGITS + value], 1u);
        } else {
            atomicAdd(&histogram[counter_of(value, pair, arrayLength(&histogram))], 1u);
        }
    }
}

// Add the sums of the workgroup to the histogram.
fn add_sums(thread: u32) {
    for (var i = thread; i < NEAR * DIGITS; i += THREADS) {
        let sum = atomicLoad(&digit_sums[i]);
        if (sum > 0u) {
            let pair = (first_block + i / DIGITS) * SORT_BLOCK;
            atomicAdd(&histogram[counter_of(i % DIGITS, pair, arrayLength(&histogram))], sum);
        }
    }
}

@compute @workgroup_size(THREADS)
fn emit(
    @builtin(global_invocation_id) invocation: vec3u,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(local_invocation_index) thread: u32
) {
    // Step 1: clear the sums of the workgroup, whose pairs begin in `first_block`.
    for (var i = thread; i < NEAR * DIGITS; i += THREADS) {
        atomicStore(&digit_sums[i], 0u);
    }
    first_block = run_of(workgroup.x * THREADS).pair / SORT_BLOCK;
    workgroupBarrier();
    // Step 2: list the tiles of each splat of the run, in order of depth: the sort by tile is stable.
    let run = run_of(invocation.x);
    var pair = run.pair;
    for (var rank = run.first; rank < run.end; rank++) {
        let id = order[rank];
        let shape = vector_of(shapes[shape_at(id)]);
        let weight = vector_of(weights[weight_at(id)]);
        let ellipse = outline(shape.xy, vec3f(shape.zw, weight.x), weight.y, weight.w);
        for (var row = ellipse.rows.x; row < ellipse.rows.y; row++) {
            var listed = 0u;  // an earlier copy has listed the columns before this one
            for (var copy = FIRST_COPY; copy < FIRST_COPY + COPIES; copy++) {
                let tiles = span(ellipse, row, copy);
                let column = max(tiles.x, listed);
                let next = list_tiles(id, row, column, tiles.y, pair);
                count_tiles(row * image_tiles().x + column, pair, next);
                pair = next;
                listed = max(tiles.y, listed);
            }
        }
    }
    // Step 3: add the digits that all invocations counted.
    workgroupBarrier();
    add_sums(thread);
}
