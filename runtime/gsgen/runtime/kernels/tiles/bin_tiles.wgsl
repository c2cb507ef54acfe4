// Bin: list the tiles that each splat touches, nearest splat first.
//
// `measure` and `emit` cut the sorted splats into runs, one per invocation: the first adds up the
// tiles of each run, the second starts where the scan of these sums tells it to.

//!include frame

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> colors: array<vec4f>;  // the last: how many tiles
@group(0) @binding(4) var<storage, read> shapes: array<vec4f>;
@group(0) @binding(5) var<storage, read> weights: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> run_pairs: array<u32>;
@group(0) @binding(7) var<storage, read_write> pair_tiles: array<u32>;
@group(0) @binding(8) var<storage, read_write> pair_splats: array<u32>;

//!include tile_span

fn tiles_of(id: u32) -> u32 {
    return u32(colors[id].w);
}

//!include measure_runs

@compute @workgroup_size(THREADS)
fn emit(@builtin(global_invocation_id) invocation: vec3u) {
//!include begin_run
    for (var rank = invocation.x * RUN; rank < end; rank++) {
        let id = order[rank];
        let shape = shapes[id];
        let weight = weights[id];
        let made = outline(shape.xy, vec3f(shape.zw, weight.x), weight.y, weight.w);
        for (var row = made.rows.x; row < made.rows.y; row++) {
            var behind = 0u;
//!repeat COPY COPIES
            {
                let tiles = span(made, row, COPYu);
                for (var column = max(tiles.x, behind); column < tiles.y; column++) {
                    if (place < room) {
                        pair_tiles[place] = row * frame.tiles.x + column;
                        pair_splats[place] = id;
                    }
                    place += 1u;
                }
                behind = max(tiles.y, behind);
            }
//!end
        }
    }
}
