// Blend: composite each tile's splats, front to back.
//
// One workgroup per tile. An invocation has COLUMNS × QUADS cells, each of four pixels above each
// other; its columns are TILE / COLUMNS apart. A splat is read once for all of them, and a cell
// that it does not touch is left out. The cells are written out by `repeat`: drivers keep an
// array of them in memory instead of registers, which is two to three times as slow.
//
// `through` is what light still passes a pixel; once a splat would let pass less than
// MIN_TRANSMITTANCE, that splat is left out and the pixel is finished, which its sign tells.
//
// With PICK the image is not of colours: it has Σ w z, the depth where half of the light is gone,
// the index of the Gaussian that took it, and alpha.

//!include frame

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read> shapes: array<vec4f>;
@group(0) @binding(4) var<storage, read> weights: array<vec4f>;
@group(0) @binding(5) var<storage, read> colors: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> image: array<vec4u>;

const ZERO = vec4f(0.0);

@compute @workgroup_size(TILE / COLUMNS, TILE / (4u * QUADS))
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let range = ranges[tile.y * frame.tiles.x + tile.x];
    let corner = vec2u(tile.x * TILE + local.x, tile.y * TILE + local.y * 4u * QUADS);
    let x = f32(corner.x) + 0.5 - frame.origin.x;
    let y = f32(corner.y) + 0.5 - frame.origin.y + vec4f(0.0, 1.0, 2.0, 3.0);
//!repeat CELL CELLS
    var through_CELL = vec4f(1.0);
    var red_CELL = ZERO;
    var green_CELL = ZERO;
    var blue_CELL = ZERO;
    var taker_CELL = vec4u(ABSENT);
//!end
    for (var pair = range.x; pair < range.y; pair++) {
        let id = pair_splats[pair];
        let shape = shapes[id];
        let weight = weights[id];
        let color = colors[id];
        let bend = 0.5 * weight.x;
        var most = ZERO;
//!repeat CELL CELLS
        {
            let dx = x + f32(CELLu / QUADS * (TILE / COLUMNS)) - shape.x;
            let dy = y + f32(CELLu % QUADS * 4u) - shape.y;
            let above = weight.y - 0.5 * shape.z * dx * dx - (bend * dy + shape.w * dx) * dy;
            if (any(above >= ZERO)) {
                let before = through_CELL;
                let alpha = min(CULL_OPACITY * exp(above), vec4f(MAX_ALPHA));
                let after = before * (1.0 - alpha);
                let hit = (above >= ZERO) & (before > ZERO);
                let enough = after > vec4f(MIN_TRANSMITTANCE);
                let amount = select(ZERO, alpha * before, hit & enough);
                if (PICK) {
                    red_CELL += amount * weight.z;
                    let halved = hit & (before >= vec4f(0.5)) & (after < vec4f(0.5));
                    green_CELL = select(green_CELL, vec4f(weight.z), halved);
                    taker_CELL = select(taker_CELL, vec4u(id), halved);
                } else {
                    red_CELL += amount * color.x;
                    green_CELL += amount * color.y;
                    blue_CELL += amount * color.z;
                }
                through_CELL = select(before, select(-before, after, enough), hit);
            }
            most = max(most, through_CELL);
        }
//!end
        if (!any(most > ZERO)) {
            break;
        }
    }
//!repeat CELL CELLS
    {
        let rest = abs(through_CELL);
        let column = corner.x + CELLu / QUADS * (TILE / COLUMNS);
        let row = corner.y + CELLu % QUADS * 4u;
        for (var i = 0u; i < 4u; i++) {
            if (column < frame.size.x && row + i < frame.size.y) {
                let at = (row + i) * frame.size.x + column;
                let alpha = 1.0 - rest[i];
                if (PICK) {
                    let depths = bitcast<vec2u>(vec2f(red_CELL[i], green_CELL[i]));
                    image[at] = vec4u(depths, taker_CELL[i], bitcast<u32>(alpha));
                } else {
                    let color = vec4f(red_CELL[i], green_CELL[i], blue_CELL[i], alpha);
                    image[at] = bitcast<vec4u>(color + rest[i] * frame.background);
                }
            }
        }
    }
//!end
}
