// The opacities of a splat at four pixels above each other, by two exponentials instead of four.
//
// Down a column the exponent is a parabola. So each pixel has the opacity of the pixel above it,
// times a ratio, and each ratio is the one above it, times a constant. The opacity of the first must
// not underflow where a splat reaches the fourth: STEEP splats, of cameras whose dilation is below
// LEAST_DILATION, take four exponentials.

//!include frame
//!include blend_opacity

const UNDERFLOW = -110.0;  // an exponent; above it, no ratio exceeds 2^50

// A splat relative to a tile. Its opacity at an offset (x, y) is
// CULL_OPACITY · 2^(peak − across · x² − bend · (y + lean · x)²).
struct Falloff {
    mean: vec2f,   // from the centre of the tile's first pixel, in pixels
    across: f32,
    peak: f32,
    bend: f32,
    lean: f32,
    change: f32,   // from one ratio to the next
}

// shape, weight: of the splat, as projection writes them.
fn falloff_of(tile: vec2u, shape: vec4f, weight: vec4f) -> Falloff {
    let first = vec2f(tile * TILE) + 0.5 - frame.origin;
    let variance_xx = weight.w * weight.x / shape.z;
    let bend = 0.5 * TO_BINARY * weight.x;
    return Falloff(
        shape.xy - first,
        0.5 * TO_BINARY / variance_xx,
        weight.y * TO_BINARY,
        bend,
        shape.w / weight.x,
        scaled_power(1.0, vec2f(-2.0 * bend)).x,
    );
}

// Return the opacities at four pixels, 0 where they are less than CULL_OPACITY.
// exponent: `peak − across · x²` of the column; y: of the first pixel, plus lean · x.
fn column_opacity(splat: Falloff, exponent: f32, y: f32) -> vec4f {
    let slope = splat.bend * y;
    let first = exponent - slope * y;
    var alpha: vec4f;
    if (STEEP) {
        let rows = vec4f(y, y + 1.0, y + 2.0, y + 3.0);
        let above = max(exponent - splat.bend * rows * rows, vec4f(UNDERFLOW));
        alpha = vec4f(scaled_power(CULL_OPACITY, above.xy), scaled_power(CULL_OPACITY, above.zw));
    } else {
        let powers = scaled_power(1.0, vec2f(first, -(slope + slope) - splat.bend));
        let second_ratio = powers.y * splat.change;
        alpha.x = select(0.0, CULL_OPACITY * powers.x, first > UNDERFLOW);
        alpha.y = alpha.x * powers.y;
        alpha.z = alpha.y * second_ratio;
        alpha.w = alpha.z * (second_ratio * splat.change);
    }
    return select(vec4f(0.0), limited(alpha), alpha >= vec4f(CULL_OPACITY));
}
