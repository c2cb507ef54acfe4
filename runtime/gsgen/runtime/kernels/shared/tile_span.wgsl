// Which tiles a splat touches: one function for those who count and those who list them.
//
// In each row of tiles it is a span, the exact extent of the ellipse dᵀ conic d ≤ reach within
// the row's band of pixel centres. In terms of the covariance, at height y the ellipse goes from
// c(y) − h(y) to c(y) + h(y) with c = y·xy/yy and h² = (reach − y²/yy)·det/yy; it is farthest
// right at y = xy·√(reach/xx). Of the conic: xy/yy is −conic.xy/conic.xx, det/yy is 1/conic.xx.
//
// In a panorama a splat is there once more a whole turn to the left, and to the right: COPIES are
// numbered in this order, and 1 is the one nearest to the middle of the image. None reaches
// farther than half a turn. Those that list tiles leave out what an earlier copy touched.

struct Outline {
    mean: vec2f,
    half_height: f32,
    lean: f32,          // xy / yy
    width: f32,         // det / yy
    reach: f32,
    inverse_yy: f32,
    rightmost: f32,     // the y where the ellipse is farthest right
    rows: vec2u,        // the first row of tiles, and one behind the last
}

const SLACK = 1.0001;   // of the reach: rounding must not lose a pixel
const EDGE = 0.001;     // pixels

fn tile_at(pixel: f32, limit: u32) -> u32 {
    return u32(clamp(floor(pixel / f32(TILE)), 0.0, f32(limit)));
}

// mean: in pixels, relative to the frame's origin; strength: the logarithm of the opacity over
// CULL_OPACITY; variance_yy: of the 2D covariance.
fn outline(mean: vec2f, conic: vec3f, strength: f32, variance_yy: f32) -> Outline {
    var made: Outline;
    made.mean = mean + frame.origin;
    made.reach = 2.0 * strength * SLACK;
    made.half_height = sqrt(made.reach * variance_yy) + EDGE;
    made.lean = -conic.y / conic.x;
    made.width = 1.0 / conic.x;
    made.inverse_yy = 1.0 / variance_yy;
    let variance_xx = variance_yy * conic.z / conic.x;
    made.rightmost = made.lean * variance_yy * sqrt(made.reach / variance_xx);
    // A pixel's centre is half a pixel from its edge.
    let first = ceil(made.mean.y - made.half_height - 0.5);
    let last = floor(made.mean.y + made.half_height - 0.5);
    let begin = tile_at(first, frame.tiles.y);
    made.rows = vec2u(begin, max(begin, tile_at(last + f32(TILE), frame.tiles.y)));
    return made;
}

// How far left and right of its mean a splat reaches, from one height above it to another.
fn extent(made: Outline, heights: vec2f) -> vec2f {
    let band = clamp(heights, vec2f(-made.half_height), vec2f(made.half_height));
    let right_y = clamp(made.rightmost, band.x, band.y);
    let left_y = clamp(-made.rightmost, band.x, band.y);
    let right = made.lean * right_y
        + sqrt(max(made.reach - right_y * right_y * made.inverse_yy, 0.0) * made.width) + EDGE;
    let left = made.lean * left_y
        - sqrt(max(made.reach - left_y * left_y * made.inverse_yy, 0.0) * made.width) - EDGE;
    return vec2f(left, right);
}

// The first tile of a copy's span in a row of tiles, and one behind the last.
fn span(made: Outline, row: u32, copy: u32) -> vec2u {
    let top = f32(row * TILE) + 0.5 - made.mean.y;
    let ends = extent(made, vec2f(top, top + f32(TILE) - 1.0));
    var left = ends.x;
    var right = ends.y;
    var middle = made.mean.x;
    if (PANORAMA) {
        let most = 0.5 * frame.period + EDGE;
        right = min(right, most);
        left = max(left, -most);
        middle += (f32(copy) - 1.0) * frame.period;
    }
    let begin = tile_at(ceil(middle + left - 0.5), frame.tiles.x);
    let end = tile_at(floor(middle + right - 0.5) + f32(TILE), frame.tiles.x);
    return vec2u(begin, max(begin, end));
}
