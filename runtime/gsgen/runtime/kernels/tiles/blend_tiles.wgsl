// Blend: composite each tile's splats, front to back.
//
// One workgroup per tile. A splat is read once for all cells of an invocation, and cells that it
// does not touch are left out.
//
// A splat that would let less light pass than MIN_TRANSMITTANCE is left out, and the pixel is
// finished: the sign of its transmittance says so.
//
// With PICK the image has no colours: it has Σ w z, the depth where half of the light is gone,
// the index of the Gaussian that took it, and alpha.

//!include blend_tile

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let range = begin_tile(tile.xy, local.xy);
    for (var pair = range.x; pair < range.y; pair++) {
        let id = pair_splats[pair];
        blend_splat(id, shapes[id], weights[id].xyz, colors[id].xyz, 0u);
        if (!is_open()) {
            break;
        }
    }
    end_tile();
}
