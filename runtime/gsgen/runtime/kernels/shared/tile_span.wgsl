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

fn tile_at(pixel: f32, limit: u32) -> u32 {
    return u32(clamp(floor(pixel / f32(TILE)), 0.0, f32(limit)));
}

// mean: in pixels, relative to the frame's origin; strength: the logarithm of the opacity over
// CULL_OPACITY; variance_yy: of the 2D covariance.
fn outline(mean: vec2f, conic: vec3f, strength: f32, variance_yy: f32) -> Outline {
    var result: Outline;
    result.mean = mean + frame.origin;
    result.reach = 2.0 * strength * SLACK;
    result.half_height = sqrt(result.reach * variance_yy) + EDGE;
    result.lean = -conic.y / conic.x;
    result.width = 1.0 / conic.x;
    result.inverse_yy = 1.0 / variance_yy;
    let variance_xx = variance_yy * conic.z / conic.x;
    result.rightmost = result.lean * variance_yy * sqrt(result.reach / variance_xx);
    // A pixel's centre is half a pixel from its edge.
    let first = ceil(result.mean.y - result.half_height - 0.5);
    let last = floor(result.mean.y + result.half_height - 0.5);
    let begin = tile_at(first, image_tiles().y);
    result.rows = vec2u(begin, max(begin, tile_at(last + f32(TILE), image_tiles().y)));
    return result;
}

// Return the leftmost and rightmost x of an ellipse between two heights, relative to its mean.
fn extent(ellipse: Outline, heights: vec2f) -> vec2f {
    let band = clamp(heights, vec2f(-ellipse.half_height), vec2f(ellipse.half_height));
    let right_y = clamp(ellipse.rightmost, band.x, band.y);
    let left_y = clamp(-ellipse.rightmost, band.x, band.y);
    let right = ellipse.lean * right_y
        + sqrt(max(ellipse.reach - right_y * right_y * ellipse.inverse_yy, 0.0) * ellipse.width) + EDGE;
    let left = ellipse.lean * left_y
        - sqrt(max(ellipse.reach - left_y * left_y * ellipse.inverse_yy, 0.0) * ellipse.width) - EDGE;
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
