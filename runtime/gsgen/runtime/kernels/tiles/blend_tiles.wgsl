// Blend: composite each tile's splats, front to back.
//
// One workgroup per tile. A splat is read once for all cells of an invocation, and skips cells that
// it does not touch.
//
// A splat that would leave less light than MIN_TRANSMITTANCE is skipped, and the pixel is finished,
// which the sign of its transmittance stores.
//
// With PICK a pixel has no colour, but Σ w z, the median depth (where half of the light is gone),
// the index of the Gaussian at that depth, and alpha.

//!include blend_tile

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) local: vec3u) {
    // Step 1: begin with all light, and an empty colour.
    let range = begin_tile(tile.xy, local.xy);
    // Step 2: blend the splats of the tile, nearest first, until no pixel is open.
    for (var pair = range.x; pair < range.y; pair++) {
        let id = pair_splats[pair];
        let shape = vector_of(shapes[shape_at(id)]);
        blend_splat(id, shape, vector_of(weights[weight_at(id)]).xyz, vector_of(colors[id]).xyz);
        if (!is_open()) {
            break;
        }
    }
    // Step 3: what light is left shows the background.
    end_tile();
}
