// List: write the splats that touch each tile, nearest first, without a sort of pairs.
//
// The sorted splats are divided into runs, one per invocation. The kernel is compiled twice: first it
// counts the splats of each run by tile, in counters of the run, so that the result does not depend
// on timing. list_ranges.wgsl converts the counters to indices. If LISTS, it then writes each splat
// where the counter of its tile points. A run's splats are sorted, and runs follow each other.

//!include splat_record
//!include tile_window
//!include words

@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> windows: array<u32>;  // by splat, in the second half
@group(0) @binding(4) var<storage, read_write> counters: array<u32>;
@group(0) @binding(5) var<storage, read_write> tile_splats: array<u32>;
@group(0) @binding(6) var<storage, read> shapes: array<Quad>;
@group(0) @binding(7) var<storage, read> weights: array<Quad>;
@group(0) @binding(8) var<storage, read_write> ranked: array<u32>;  // windows in order of depth

var<private> capacity: u32;  // of `tile_splats`

// Count or list a splat in a tile. Splats beyond the capacity are not written: the frame is drawn
// again with a larger one. `first` is the index of the run's counter of tile 0.
fn visit(tile: u32, splat: u32, first: u32) {
    let counter = first + THREADS * tile;
    let index = counters[counter];
    counters[counter] = index + 1u;
    if (LISTS && index < capacity) {
        tile_splats[index] = splat;
    }
}

fn visit_all(splat: u32, first: u32) {
    let shape = vector_of(shapes[shape_at(splat)]);
    let weight = vector_of(weights[weight_at(splat)]);
    let ellipse = outline(shape.xy, vec3f(shape.zw, weight.x), weight.y, weight.w);
    for (var row = ellipse.rows.x; row < ellipse.rows.y; row++) {
        var listed = 0u;  // an earlier copy has listed the columns before this one
        for (var copy = FIRST_COPY; copy < FIRST_COPY + COPIES; copy++) {
            let tiles = span(ellipse, row, copy);
            for (var column = max(tiles.x, listed); column < tiles.y; column++) {
                visit(row * image_tiles().x + column, splat, first);
            }
            listed = max(tiles.y, listed);
        }
    }
}

@compute @workgroup_size(THREADS)
fn walk(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    // Step 1: find the run of this invocation, and its counters.
    let across = image_tiles().x;
    let tiles = across * image_tiles().y;
    let first = group.x * THREADS * tiles + local;
    let visible = counts[VISIBLE];
    let run = (visible + groups.x * THREADS - 1u) / (groups.x * THREADS);
    var rank = (group.x * THREADS + local) * run;
    let end = min(rank + run, visible);
    let own_windows = arrayLength(&windows) / 2u;
    capacity = counts[PAIR_CAPACITY];
    var splat = 0u;
    var window = 0u;
    // Step 2: walk the tiles of the run's splats, nearest splat first.
    // One turn takes one tile, so that invocations with few tiles need not wait for others. In each
    // turn all of them read their next splat, needed or not: Mesa's llvmpipe branches for each
    // invocation that may read, and the CPU cannot predict which ones do.
    while (rank < end || window != 0u) {
        let next = min(rank, end - 1u);
        let next_splat = order[next];
        var next_window: u32;
        if (LISTS) {
            next_window = ranked[next];
        } else {
            next_window = windows[own_windows + next_splat];
            ranked[next] = next_window;
        }
        if (window == 0u) {
            splat = next_splat;
            window = next_window;
            rank += 1u;
            if (window == LARGE) {
                visit_all(splat, first);
                window = 0u;
            }
        }
        let touched = window & WINDOW_TILES;
        if (touched != 0u) {
            visit(tile_in_window(window, firstTrailingBit(touched), across), splat, first);
            window &= window - 1u;
        }
        window = select(0u, window, (window & WINDOW_TILES) != 0u);
    }
}
