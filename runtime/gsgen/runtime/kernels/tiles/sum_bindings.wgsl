// What both ways to sum bind, and know.

//!include frame

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(2) var<storage, read> pair_cells: array<u32>;
@group(0) @binding(3) var<storage, read> spans: array<vec4u>;    // first Gaussian, how many, 1 / divisor, weight of what is behind
@group(0) @binding(4) var<storage, read> shapes: array<vec4f>;   // mean, conic xx xy
@group(0) @binding(5) var<storage, read> weights: array<vec4f>;  // conic yy, strength, depth, the circle's radius²
@group(0) @binding(6) var<storage, read> colors: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> image: array<vec4u>;

const ZERO = vec4f(0.0);
const SLACK = 1.01;    // of squares: rounding must not lose a pixel
const FLATTEST = 1e-5; // below this share of its product, a determinant is mostly rounding

// Whether a Gaussian may reach a pixel of the tile around `middle`: not, if all are beyond its
// circle, or beyond the box around its ellipse. All tiles of its cell ask.
fn reaches(middle: vec2f, shape: vec4f, weight: vec4f) -> bool {
    let away = vec2f(nearest(shape.x - middle.x), shape.y - middle.y);
    let outside = max(abs(away) - 0.5 * f32(TILE - 1u), vec2f(0.0));
    let squares = outside * outside;
    let product = shape.z * weight.x;
    let determinant = product - shape.w * shape.w;
    let box = 2.0 * SLACK * weight.y * vec2f(weight.x, shape.z) / determinant;
    let beyond = determinant > FLATTEST * product && any(squares > box + 0.01);
    return weight.y >= 0.0 && squares.x + squares.y <= SLACK * weight.w && !beyond;
}

//!include blend_opacity
//!repeat ONCE LAYERED

// The image is the first of LAYERS layers; meshes, if there are any, are the last, whose depths
// are here already. Nothing behind them counts.
@group(1) @binding(0) var<storage, read_write> layer_depths: array<f32>;

fn limits(corner: vec2u) -> vec4f {
    var made = vec4f(NOWHERE);
    for (var i = 0u; i < 4u; i++) {
        if (LAYERS > 1u && corner.x < frame.size.x && corner.y + i < frame.size.y) {
            let line = (LAYERS - 1u) * frame.size.y + corner.y + i;
            made[i] = min(layer_depths[line * frame.size.x + corner.x], NOWHERE);
        }
    }
    return made;
}
//!end
