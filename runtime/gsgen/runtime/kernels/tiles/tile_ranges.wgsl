// Ranges: find the first and last pair of each tile.
//
// Each invocation looks at RUN pairs, which are sorted by tile. Tiles without pairs keep zeros.

@group(0) @binding(0) var<storage, read> counts: array<u32>;
@group(0) @binding(1) var<storage, read> pair_tiles: array<u32>;
@group(0) @binding(2) var<storage, read_write> ranges: array<vec2u>;

@compute @workgroup_size(THREADS)
fn mark(@builtin(global_invocation_id) invocation: vec3u) {
    let pairs = counts[PAIRS];
    let start = invocation.x * RUN;
    let end = min(start + RUN, pairs);
    if (start >= end) {
        return;
    }
    // Step 1: the tile of the pair before tells whether the run begins a tile.
    var before = ABSENT;
    if (start > 0u) {
        before = pair_tiles[start - 1u];
    }
    // Step 2: where the tile changes, one range ends and the next begins. No two invocations see the
    // same change, so none overwrites another.
    for (var pair = start; pair < end; pair++) {
        let tile = pair_tiles[pair];
        if (tile != before) {
            ranges[tile].x = pair;
            if (pair > 0u) {
                ranges[before].y = pair;
            }
        }
        before = tile;
    }
    // Step 3: the last tile has no change after it.
    if (end == pairs) {
        ranges[before].y = pairs;
    }
}
