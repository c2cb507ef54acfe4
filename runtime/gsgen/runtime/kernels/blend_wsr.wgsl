// Blend by weighted sums: composite each tile's cells, front to back, whose Gaussians are summed.
//
// One workgroup per tile, invocations as in blend_tiles.wgsl. `through` is what light still passes
// a pixel. Within a cell every Gaussian is weighed by what passed before the cell, `open`, so the
// order of a cell's Gaussians does not count. Once less than FINISHED is left, further cells are
// left out, and so is what is behind.
//
// `total` is Σ w, `behind` Σ w b with b the weight of what is behind, as the Gaussian's set has it.
// With PICK the image is not of colours: it has Σ w z, the depth where half of the light is gone,
// the index of the Gaussian that covered most in that cell, and alpha.

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

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let range = ranges[tile.y * frame.tiles.x + tile.x];
    let corner = vec2u(tile.x * TILE + local.x, tile.y * TILE + local.y * 4u * QUADS);
    let x = f32(corner.x) + 0.5 - frame.origin.x;
    let y = f32(corner.y) + 0.5 - frame.origin.y + vec4f(0.0, 1.0, 2.0, 3.0);
//!repeat PART PARTS
    var through_PART = vec4f(1.0);
    var open_PART = vec4f(1.0);
    var total_PART = ZERO;
    var behind_PART = ZERO;
    var red_PART = ZERO;
    var green_PART = ZERO;
    var blue_PART = ZERO;
    var taker_PART = vec4u(ABSENT);
    var most_PART = ZERO;
    var most_depth_PART = ZERO;
    var most_id_PART = vec4u(ABSENT);
//!repeat ONCE LAYERED
    let limit_PART = limits(corner + vec2u(PARTu / QUADS * (TILE / COLUMNS), PARTu % QUADS * 4u));
    var far_PART = ZERO;
//!end
//!end
    for (var pair = range.x; pair < range.y; pair++) {
        var still = ZERO;
//!repeat PART PARTS
        open_PART = select(ZERO, through_PART, through_PART >= vec4f(FINISHED));
        still = max(still, open_PART);
        most_PART = ZERO;
//!end
        if (!any(still > ZERO)) {
            break;
        }
        let span = spans[pair_cells[pair]];
        let factors = bitcast<vec2f>(span.zw);
        for (var id = span.x; id < span.x + span.y; id++) {
            let weight = weights[id];
            if (!(weight.y >= 0.0)) {
                continue;
            }
            let shape = shapes[id];
            let color = colors[id];
            let bend = 0.5 * weight.x;
//!repeat PART PARTS
            {
                let dx = nearest(x + f32(PARTu / QUADS * (TILE / COLUMNS)) - shape.x);
                let dy = y + f32(PARTu % QUADS * 4u) - shape.y;
                let above = weight.y - 0.5 * shape.z * dx * dx - (bend * dy + shape.w * dx) * dy;
                var hit = (above >= ZERO) & (dx * dx + dy * dy <= vec4f(weight.w)) & (open_PART > ZERO);
//!repeat ONCE LAYERED
                hit = hit & (vec4f(weight.z) <= limit_PART);
//!end
                if (any(hit)) {
                    let alpha = select(ZERO, factors.x * opacity(above), hit);
                    let amount = alpha * open_PART;
                    through_PART *= max(1.0 - alpha, ZERO);
                    total_PART += amount;
                    behind_PART += amount * factors.y;
//!repeat ONCE LAYERED
                    far_PART += amount * weight.z;
//!end
                    if (PICK) {
                        red_PART += amount * weight.z;
                        let more = alpha > most_PART;
                        most_PART = select(most_PART, alpha, more);
                        most_depth_PART = select(most_depth_PART, vec4f(weight.z), more);
                        most_id_PART = select(most_id_PART, vec4u(id), more);
                    } else {
                        red_PART += amount * color.x;
                        green_PART += amount * color.y;
                        blue_PART += amount * color.z;
                    }
                }
            }
//!end
        }
        if (PICK) {
//!repeat PART PARTS
            {
                let halved = (open_PART >= vec4f(0.5)) & (through_PART < vec4f(0.5));
                green_PART = select(green_PART, most_depth_PART, halved);
                taker_PART = select(taker_PART, most_id_PART, halved);
            }
//!end
        }
    }
//!repeat PART PARTS
    {
        let column = corner.x + PARTu / QUADS * (TILE / COLUMNS);
        let row = corner.y + PARTu % QUADS * 4u;
        for (var i = 0u; i < 4u; i++) {
            if (column < frame.size.x && row + i < frame.size.y) {
                let at = (row + i) * frame.size.x + column;
                let total = total_PART[i];
                var alpha = 0.0;
                var share = 0.0;      // of Σ w c in the picture
                var backdrop = 1.0;
                if (total > 0.0) {
                    let left = through_PART[i];
                    let weight = select(behind_PART[i] / total, 0.0, left < FINISHED);
                    share = 1.0 / (total + weight * left);
                    alpha = total * share;
                    backdrop = weight * select(left, 1.0, PUBLISHED) * share;
                }
//!repeat ONCE LAYERED
                layer_depths[at] = NOWHERE;
                if (total > 0.0) {
                    layer_depths[at] = min(far_PART[i] / total, limit_PART[i]);
                }
//!end
                if (PICK) {
                    let depths = bitcast<vec2u>(vec2f(red_PART[i] * share, green_PART[i]));
                    image[at] = vec4u(depths, taker_PART[i], bitcast<u32>(alpha));
                } else {
                    let color = vec3f(red_PART[i], green_PART[i], blue_PART[i]) * share;
                    image[at] = bitcast<vec4u>(vec4f(color + backdrop * frame.background.xyz, alpha));
                }
            }
        }
    }
//!end
}
