// The tiles that a splat touches, for the kernel that counts them and the kernel that lists them.
//
// In each row of tiles they are a span: the exact extent of the ellipse dᵀ conic d ≤ reach within
// the row's band of pixel centres. In terms of the covariance, at height y the ellipse goes from
// c(y) − h(y) to c(y) + h(y) with c = y·xy/yy and h² = (reach − y²/yy)·det/yy; it is farthest
// right at y = xy·√(reach/xx). By the conic, xy/yy = −conic.xy/conic.xx and det/yy = 1/conic.xx.
//
// In a panorama a splat is drawn again a full turn to the left and to the right: COPIES are
// numbered from the left, and copy 1 is nearest to the middle of the image. No copy reaches farther
// than half a turn. Kernels that list tiles leave out the tiles that an earlier copy touched.

//!include frame

struct Outline {
    mean: vec2f,
    half_height: f32,
    lean: f32,          // xy / yy
    width: f32,         // det / yy
    reach: f32,
    inverse_yy: f32,
    rightmost: f32,     // the y where the ellipse is farthest right
    rows: vec2u,        // the first row of tiles, and one past the last
}

const SLACK = 1.0001;   // factor of the reach: rounding must not lose a pixel
const EDGE = 0.001;     // pixels

// Return `x` within `low` and `high`; `low` for NaN. A CPU takes one instruction for each choice, and
// three for min() or max(), of which drivers return the other number where one is NaN.
fn bounded(x: f32, low: f32, high: f32) -> f32 {
    let above = select(low, x, x > low);
    return select(high, above, above < high);
}

// Return the tile of a pixel, from 0 to `limit`. Mesa's llvmpipe converts floats to u32 lane by lane.
// So 2²³ is added, which puts the integer into the low bits of a float.
fn tile_at(pixel: f32, limit: u32) -> u32 {
    let tile = bounded(floor(pixel / f32(TILE)), 0.0, f32(limit));
    return bitcast<u32>(tile + 8388608.0) & 0x7fffffu;
}

// mean: in pixels, relative to the frame's origin; strength: the logarithm of the opacity over
// CULL_OPACITY; variance_yy: of the 2D covariance.
fn outline(mean: vec2f, conic: vec3f, strength: f32, variance_yy: f32) -> Outline {
    var result: Outline;
    result.mean = mean + frame.origin;
    result.reach = 2.0 * strength * SLACK;
    result.half_height = sqrt(result.reach * variance_yy) + EDGE;
    result.width = 1.0 / conic.x;
    result.lean = -conic.y * result.width;
    result.inverse_yy = 1.0 / variance_yy;
    let variance_xx = variance_yy * conic.z * result.width;
    result.rightmost = result.lean * variance_yy * sqrt(result.reach / variance_xx);
    // A pixel's centre is half a pixel from its edge.
    let first = ceil(result.mean.y - result.half_height - 0.5);
    let last = floor(result.mean.y + result.half_height - 0.5);
    let begin = tile_at(first, image_tiles().y);
    result.rows = vec2u(begin, max(begin, tile_at(last + f32(TILE), image_tiles().y)));
    return result;
}

// Return half the width of an ellipse at a height.
fn half_width_at(ellipse: Outline, y: f32) -> f32 {
    let reach = ellipse.reach - y * y * ellipse.inverse_yy;
    return sqrt(select(0.0, reach, reach > 0.0) * ellipse.width) + EDGE;
}

// Return the leftmost and rightmost x of an ellipse between two heights, relative to its mean.
fn extent(ellipse: Outline, heights: vec2f) -> vec2f {
    let top = bounded(heights.x, -ellipse.half_height, ellipse.half_height);
    let bottom = bounded(heights.y, -ellipse.half_height, ellipse.half_height);
    let right_y = bounded(ellipse.rightmost, top, bottom);
    let left_y = bounded(-ellipse.rightmost, top, bottom);
    let right = ellipse.lean * right_y + half_width_at(ellipse, right_y);
    let left = ellipse.lean * left_y - half_width_at(ellipse, left_y);
    return vec2f(left, right);
}

// Return the first tile that a copy touches in a row of tiles, and one past the last.
fn span(ellipse: Outline, row: u32, copy: u32) -> vec2u {
    let top = f32(row * TILE) + 0.5 - ellipse.mean.y;
    let ends = extent(ellipse, vec2f(top, top + f32(TILE) - 1.0));
    var left = ends.x;
    var right = ends.y;
    var middle = ellipse.mean.x;
    if (PANORAMA) {
        let most = 0.5 * frame.period + EDGE;
        right = min(right, most);
        left = max(left, -most);
        middle += (f32(copy) - 1.0) * frame.period;
    }
    let begin = tile_at(ceil(middle + left - 0.5), image_tiles().x);
    let end = tile_at(floor(middle + right - 0.5) + f32(TILE), image_tiles().x);
    return vec2u(begin, max(begin, end));
}
