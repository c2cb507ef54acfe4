// Runs of the sorted splats or cells, one per invocation: `measure` sums the tiles of each run, and
// `emit` of the including file writes the pairs of each run at the index that the scan computed.

//!include frame

@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> tile_counts: array<vec4f>;  // by splat or cell: w is the number of tiles
@group(0) @binding(4) var<storage, read_write> run_pairs: array<u32>;
@group(0) @binding(5) var<storage, read_write> pair_tiles: array<u32>;
@group(0) @binding(6) var<storage, read_write> pair_members: array<u32>;

@compute @workgroup_size(THREADS)
fn measure(@builtin(global_invocation_id) invocation: vec3u) {
    let visible = counts[VISIBLE];
    let end = min((invocation.x + 1u) * RUN, visible);
    var pairs = 0u;
    for (var rank = invocation.x * RUN; rank < end; rank++) {
        pairs += u32(tile_counts[order[rank]].w);
    }
    if (invocation.x * RUN < visible) {
        run_pairs[invocation.x] = pairs;
    }
}

struct Run {
    first: u32,  // rank of the first member
    end: u32,    // and one past the last
    pair: u32,   // index of the run's first pair
}

fn run_of(invocation: u32) -> Run {
    let visible = counts[VISIBLE];
    let first = invocation * RUN;
    var pair = 0u;
    if (first < visible) {
        pair = run_pairs[invocation];
    }
    return Run(first, min(first + RUN, visible), pair);
}

// List the tiles of a row from column `first` to before `end`, and return the next pair's index.
// Pairs beyond PAIR_CAPACITY are not written: the frame is drawn again with a larger capacity.
fn list_tiles(member: u32, row: u32, first: u32, end: u32, pair: u32) -> u32 {
    let capacity = counts[PAIR_CAPACITY];
    var next = pair;
    for (var column = first; column < end; column++) {
        if (next < capacity) {
            pair_tiles[next] = row * image_tiles().x + column;
            pair_members[next] = member;
        }
        next += 1u;
    }
    return next;
}
