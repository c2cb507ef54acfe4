// The opacities of a splat at four pixels above each other, by two exponentials instead of four.
//
// Down a column the exponent is a parabola. So each pixel has the opacity of the pixel above it,
// times a ratio, and each ratio is the one above it, times a constant. The opacity of the first must
// not underflow where a splat reaches the fourth: STEEP splats, of cameras whose dilation is below
// LEAST_DILATION, take four exponentials. Mesa's llvmpipe fuses the operations of exp2(), and of no
// expression of a shader: blending by `scaled_power` took 1.04 times as long. Its results are too
// large by 6e-8 on average, which POWER_SCALE takes back.

//!include frame
//!include blend_opacity

const POWER_SCALE = 0.99999994;

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
        POWER_SCALE * exp2(-2.0 * bend),
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
        alpha = POWER_SCALE * CULL_OPACITY * exp2(exponent - splat.bend * rows * rows);
    } else {
        // Two exponentials: the first opacity, and the ratio of the second to it.
        let powers = exp2(vec2f(first, -(slope + slope) - splat.bend));
        let second_ratio = powers.y * splat.change;
        alpha.x = POWER_SCALE * CULL_OPACITY * powers.x;
        alpha.y = alpha.x * powers.y;
        alpha.z = alpha.y * second_ratio;
        alpha.w = alpha.z * (second_ratio * splat.change);
    }
    // Far from a splat, 0 times an infinite ratio is NaN, which no comparison holds for.
    return select(vec4f(0.0), limited(alpha), alpha >= vec4f(CULL_OPACITY));
}
