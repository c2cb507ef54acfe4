// Ranges: find where each tile's pairs begin and end.
//
// One invocation per pair, sorted by tile. Tiles without pairs keep the zeros that they start with.

@group(0) @binding(0) var<storage, read> counts: array<u32>;
@group(0) @binding(1) var<storage, read> pair_tiles: array<u32>;
@group(0) @binding(2) var<storage, read_write> ranges: array<vec2u>;

@compute @workgroup_size(THREADS)
fn mark(@builtin(global_invocation_id) invocation: vec3u) {
    let pair = invocation.x;
    let pairs = counts[PAIRS];
    if (pair >= pairs) {
        return;
    }
    let tile = pair_tiles[pair];
    if (pair == 0u || pair_tiles[pair - 1u] != tile) {
        ranges[tile].x = pair;
    }
    if (pair + 1u == pairs || pair_tiles[pair + 1u] != tile) {
        ranges[tile].y = pair + 1u;
    }
}
