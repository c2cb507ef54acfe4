// The pixels of an invocation that blends a tile.
//
// An invocation has CELLS = COLUMNS × QUADS cells, each of four pixels above each other; its
// columns are TILE / COLUMNS apart.

//!include frame

var<private> corner: vec2u;  // the first pixel of the first cell …
var<private> x: f32;         // … and its centre, relative to the frame's origin,
var<private> y: vec4f;       // with those of the three pixels below it

fn place_pixels(tile: vec2u, local: vec2u) {
    corner = vec2u(tile.x * TILE + local.x, tile.y * TILE + local.y * 4u * QUADS);
    x = f32(corner.x) + 0.5 - frame.origin.x;
    y = f32(corner.y) + 0.5 - frame.origin.y + vec4f(0.0, 1.0, 2.0, 3.0);
}

// Return the first pixel of a cell, relative to `corner`.
fn offset_of(cell: u32) -> vec2u {
    return vec2u(cell / QUADS * (TILE / COLUMNS), cell % QUADS * 4u);
}

// Return the place of a pixel in the image; pixels are numbered cell by cell.
fn position_of(pixel: u32) -> vec2u {
    return corner + offset_of(pixel / 4u) + vec2u(0u, pixel % 4u);
}

// Return the length of a loop over `count` pixels. With many cells it depends on the frame, so that no
// compiler unrolls it: Mesa's llvmpipe compiled the pixels of all cells one after another, and a first
// frame of meshes, splats and weighted sums took 21 CPU-seconds. It takes 13. Loops over the pixels of
// all cells at once took 6, but each frame a tenth longer, since no cell's numbers were at a fixed place.
fn loop_length(count: u32) -> u32 {
    return select(select(0u, count, frame.size.x > 0u), count, CELLS == 1u);
}
