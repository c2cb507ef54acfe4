// Blend: composite each tile's splats, front to back.
//
// One workgroup per tile. An invocation has COLUMNS × QUADS cells, each of four pixels above each
// other; its columns are TILE / COLUMNS apart. A splat is read once for all of them, and a cell
// that it does not touch is left out.
//
// `through` is what light still passes a pixel; once a splat would let pass less than
// MIN_TRANSMITTANCE, that splat is left out and the pixel is finished, which its sign tells.
//
// With PICK the image is not of colours: it has Σ w z, the depth where half of the light is gone,
// the index of the Gaussian that took it, and alpha.

//!include blend_bindings

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) local: vec3u) {
//!include blend_start
    for (var pair = range.x; pair < range.y; pair++) {
        let id = pair_splats[pair];
        let shape = shapes[id];
        let weight = weights[id];
        let color = colors[id];
        let cells = 0u;
//!include blend_splat
        var most = ZERO;
//!repeat CELL CELLS
        most = max(most, through_CELL);
//!end
        if (!any(most > ZERO)) {
            break;
        }
    }
//!include blend_finish
}
