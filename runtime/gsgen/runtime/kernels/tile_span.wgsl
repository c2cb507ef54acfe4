// Which tiles a splat touches: one function for those who count and those who list them.
//
// In each row of tiles it is a span, the exact extent of the ellipse dᵀ conic d ≤ reach within
// the row's band of pixel centres. At height y the ellipse reaches from c(y) − h(y) to c(y) + h(y)
// with c = y·xy/yy and h² = (reach − y²/yy)·det/yy in terms of the covariance; its rightmost point
// is at y = xy·√(reach/xx).

struct Outline {
    mean: vec2f,
    extent: vec2f,      // half the ellipse's bounding box
    lean: f32,          // xy / yy
    width: f32,         // det / yy
    reach: f32,
    inverse_yy: f32,
    widest_y: f32,      // where the ellipse is farthest right
    rows: vec2u,        // first row of tiles, and one behind the last
}

const SLACK = 1.0001;   // of the reach: rounding must not lose a pixel
const EDGE = 0.001;     // pixels

fn tile_bound(pixel: f32, limit: u32) -> u32 {
    return u32(clamp(floor(pixel / f32(TILE)), 0.0, f32(limit)));
}

fn outline(shape: vec4f, weight: vec4f, variance_xx: f32) -> Outline {
    var made: Outline;
    made.mean = shape.xy + frame.origin;
    made.reach = max(reach(weight.y), 0.0) * SLACK;
    let yy = weight.w;
    made.extent = sqrt(made.reach * vec2f(variance_xx, yy)) + EDGE;
    made.lean = -shape.w / shape.z;
    made.width = 1.0 / shape.z;
    made.inverse_yy = 1.0 / yy;
    made.widest_y = made.lean * yy * sqrt(made.reach / variance_xx);
    // A pixel's centre is half a pixel from its edge.
    let first = tile_bound(made.mean.y - made.extent.y - 0.5, frame.tiles.y);
    let last = tile_bound(made.mean.y + made.extent.y - 0.5, frame.tiles.y - 1u);
    made.rows = vec2u(first, last + 1u);
    return made;
}

// The first tile of the span in a row of tiles, and one behind the last.
fn span(made: Outline, row: u32) -> vec2u {
    let top = f32(row * TILE) + 0.5 - made.mean.y;
    let band = clamp(vec2f(top, top + f32(TILE) - 1.0), vec2f(-made.extent.y), vec2f(made.extent.y));
    let right_y = clamp(made.widest_y, band.x, band.y);
    let left_y = clamp(-made.widest_y, band.x, band.y);
    let right = made.lean * right_y
        + sqrt(max(made.reach - right_y * right_y * made.inverse_yy, 0.0) * made.width) + EDGE;
    let left = made.lean * left_y
        - sqrt(max(made.reach - left_y * left_y * made.inverse_yy, 0.0) * made.width) - EDGE;
    let first = tile_bound(ceil(made.mean.x + left - 0.5), frame.tiles.x);
    let behind = tile_bound(floor(made.mean.x + right - 0.5) + f32(TILE), frame.tiles.x);
    return vec2u(first, max(first, behind));
}
