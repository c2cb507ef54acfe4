// Bin cells: list the tiles of each cell, nearest cell first.

//!include runs
//!include cell_box

@compute @workgroup_size(THREADS)
fn emit(@builtin(global_invocation_id) invocation: vec3u) {
    // The cells of a run are sorted, and runs follow each other, so that the stable sort by tile keeps
    // their order of depth.
    let run = run_of(invocation.x);
    var pair = run.pair;
    for (var rank = run.first; rank < run.end; rank++) {
        let cell = order[rank];
        let circle = tile_counts[cell];
        var listed = 0u;  // an earlier copy has listed the columns before this one
        for (var copy = FIRST_COPY; copy < FIRST_COPY + COPIES; copy++) {
            let box = box_of(circle.xy, circle.z, copy);
            for (var row = box.y; row < box.w; row++) {
                pair = list_tiles(cell, row, max(box.x, listed), box.z, pair);
            }
            listed = max(box.z, listed);
        }
    }
}
