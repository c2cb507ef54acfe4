// The tiles that a splat touches as one word: the index of the first tile of a window of WINDOW_COLUMNS ×
// WINDOW_HEIGHT tiles, and a bit for each of its tiles that is touched, row by row.

//!include tile_span

const WINDOW_COLUMNS = 4u;
const WINDOW_BITS = WINDOW_COLUMNS * WINDOW_HEIGHT;
const WINDOW_TILES = (1u << WINDOW_BITS) - 1u;
const LARGE = ABSENT;  // the word of a splat that is larger than a window, or in a panorama

// Return the bits of the tiles of a span, in a row of a window whose first column is `left`.
fn span_bits(tiles: vec2u, left: u32) -> u32 {
    return select(0u, (1u << (tiles.y - left)) - (1u << (tiles.x - left)), tiles.x < tiles.y);
}

fn window_of(ellipse: Outline) -> u32 {
    if (PANORAMA || ellipse.rows.y > ellipse.rows.x + WINDOW_HEIGHT) {
        return LARGE;
    }
    var left = ABSENT;
    var right = 0u;
//!repeat ROW WINDOW_HEIGHT
    var tiles_ROW = vec2u(0u);
    if (ellipse.rows.x + ROWu < ellipse.rows.y) {
        tiles_ROW = span(ellipse, ellipse.rows.x + ROWu, FIRST_COPY);
    }
    left = min(left, select(ABSENT, tiles_ROW.x, tiles_ROW.x < tiles_ROW.y));
    right = max(right, select(0u, tiles_ROW.y, tiles_ROW.x < tiles_ROW.y));
//!end
    if (right == 0u) {
        return 0u;
    }
    let first = ellipse.rows.x * image_tiles().x + left;
    if (right - left > WINDOW_COLUMNS || first >= (1u << (32u - WINDOW_BITS)) - 1u) {
        return LARGE;
    }
    var touched = 0u;
//!repeat ROW WINDOW_HEIGHT
    touched |= span_bits(tiles_ROW, left) << (ROWu * WINDOW_COLUMNS);
//!end
    return (first << WINDOW_BITS) | touched;
}

// Return the index of a tile of a window, in an image that is `across` tiles wide.
fn tile_in_window(window: u32, bit: u32, across: u32) -> u32 {
    return (window >> WINDOW_BITS) + bit / WINDOW_COLUMNS * across + bit % WINDOW_COLUMNS;
}
