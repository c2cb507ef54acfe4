// Bin cells: list the tiles of each cell, nearest cell first.
//
// `measure` and `emit` cut the sorted cells into runs, as bin_tiles.wgsl does.

//!include frame

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> circles: array<vec4f>;  // the last: how many tiles
@group(0) @binding(4) var<storage, read_write> run_pairs: array<u32>;
@group(0) @binding(5) var<storage, read_write> pair_tiles: array<u32>;
@group(0) @binding(6) var<storage, read_write> pair_cells: array<u32>;

//!include cell_box

fn tiles_of(cell: u32) -> u32 {
    return u32(circles[cell].w);
}

//!include measure_runs

@compute @workgroup_size(THREADS)
fn emit(@builtin(global_invocation_id) invocation: vec3u) {
//!include begin_run
    for (var rank = invocation.x * RUN; rank < end; rank++) {
        let cell = order[rank];
        let circle = circles[cell];
        var behind = 0u;
//!repeat COPY COPIES
        {
            let box = box_of(circle.xy, circle.z, COPYu);
            for (var row = box.y; row < box.w; row++) {
                for (var column = max(box.x, behind); column < box.z; column++) {
                    if (place < room) {
                        pair_tiles[place] = row * frame.tiles.x + column;
                        pair_cells[place] = cell;
                    }
                    place += 1u;
                }
            }
            behind = max(box.z, behind);
        }
//!end
    }
}
