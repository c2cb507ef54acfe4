// The state of an invocation that sums the cells of a tile, and the steps of both entry files:
// `begin_tile`; for every cell, nearest first, `enter_cell`, `add_splat` for each Gaussian and
// `leave_cell`; and `end_tile`.
//
// Within a cell every Gaussian is weighted by `open`, the light before the cell, so the order of a
// cell's Gaussians does not matter. Once less than FINISHED is left, further cells and the
// background are skipped.
//
// An invocation has PARTS = CELLS parts, each of four pixels above each other. `repeat` declares a
// variable for each part: on Mesa's llvmpipe, sums in an array of parts took 4.4 times as long with
// subgroups, 4.3 without.

//!include blend_opacity
//!include tile_pixels

@group(0) @binding(1) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(2) var<storage, read> pair_cells: array<u32>;
@group(0) @binding(3) var<storage, read> spans: array<vec4u>;    // first Gaussian, number, 1 / divisor, weight of the background
@group(0) @binding(4) var<storage, read> shapes: array<vec4f>;   // mean, conic xx xy
@group(0) @binding(5) var<storage, read> weights: array<vec4f>;  // conic yy, strength, depth, radius² of the circle
@group(0) @binding(6) var<storage, read> colors: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> image: array<vec4u>;

// If LAYERED, the image is the first of LAYERS layers. Meshes, if any, are the last layer, whose
// depths are here already: splats behind them are skipped. If CARRIED, planes of one number per pixel
// follow, from plane FIRST_PLANE on, which keep with the image what farther slabs go on from.
@group(1) @binding(0) var<storage, read_write> layer_depths: array<f32>;

const ZERO = vec4f(0.0);
const CIRCLE_SLACK = 1.01;  // factor of squares: rounding must not lose a pixel
const FLATTEST = 1e-5;      // least determinant, relative to its product, that is not mostly rounding

struct Part {
    transmittance: vec4f,   // light that still passes
    open: vec4f,            // light before the present cell; 0 once the pixel is finished
    total: vec4f,           // Σ w
    behind: vec4f,          // Σ w b, where b is the set's weight of the background
    red: vec4f,             // with PICK: Σ w z
    green: vec4f,           // with PICK: the median depth, where half of the light is gone
    blue: vec4f,
    taker: vec4u,           // with PICK: the Gaussian that covers most in the cell at that depth
    largest_alpha: vec4f,   // largest opacity of a Gaussian of the present cell …
    largest_depth: vec4f,   // … the depth of that Gaussian …
    largest_id: vec4u,      // … and its index
    limit: vec4f,           // LAYERED: the depth of meshes
    depths: vec4f,          // LAYERED: Σ w z
}

var<private> middle: vec2f;  // of the tile
var<private> kept: array<vec4u, max(KEPT * PARTS, 1u)>;  // by number and part, what slabs keep
//!repeat PART PARTS
var<private> part_PART: Part;
//!end

// Return the depths of meshes at the pixels of a part.
fn limits(part: u32) -> vec4f {
    var result = vec4f(NOWHERE);
    let rows = loop_length(4u);
    for (var i = 0u; i < rows; i++) {
        let position = position_of(4u * part + i);
        if (all(position < frame.size)) {
            let line = (LAYERS - 1u) * frame.size.y + position.y;
            result[i] = min(layer_depths[line * frame.size.x + position.x], NOWHERE);
        }
    }
    return result;
}

fn empty_part(part: u32) -> Part {
    var result: Part;
    result.transmittance = vec4f(1.0);
    result.open = vec4f(1.0);
    result.taker = vec4u(ABSENT);
    result.largest_id = vec4u(ABSENT);
    result.limit = vec4f(NOWHERE);
    if (LAYERED && LAYERS > 1u) {
        result.limit = limits(part);
    }
    return result;
}

// Read the numbers of all parts that were kept after nearer slabs, or write them for farther ones.
fn carry(writes: bool) {
    let pixels = loop_length(4u * PARTS);
    let numbers = loop_length(KEPT);
    for (var pixel = 0u; pixel < pixels; pixel++) {
        let part = pixel / 4u;
        let i = pixel % 4u;
        let position = position_of(pixel);
        if (all(position < frame.size)) {
            let index = position.y * frame.size.x + position.x;
            let plane = frame.size.x * frame.size.y;
            if (writes) {
                image[index] = vec4u(kept[part][i], kept[PARTS + part][i], kept[2u * PARTS + part][i], kept[3u * PARTS + part][i]);
            } else {
                let state = image[index];
                kept[part][i] = state.x;
                kept[PARTS + part][i] = state.y;
                kept[2u * PARTS + part][i] = state.z;
                kept[3u * PARTS + part][i] = state.w;
            }
            for (var number = 4u; number < numbers; number++) {
                let at = (FIRST_PLANE + number - 4u) * plane + index;
                if (writes) {
                    layer_depths[at] = bitcast<f32>(kept[number * PARTS + part][i]);
                } else {
                    kept[number * PARTS + part][i] = bitcast<u32>(layer_depths[at]);
                }
            }
        }
    }
}

fn kept_of(number: u32, part: u32) -> vec4f {
    return bitcast<vec4f>(kept[number * PARTS + part]);
}

fn keep(number: u32, part: u32, values: vec4f) {
    kept[number * PARTS + part] = bitcast<vec4u>(values);
}

// Return a part with its numbers after nearer slabs.
fn resumed(number: u32, part: Part) -> Part {
    var result = part;
    result.red = kept_of(0u, number);
    result.green = kept_of(1u, number);
    result.transmittance = kept_of(4u, number);
    result.open = kept_of(5u, number);
    result.total = kept_of(6u, number);
    result.behind = kept_of(7u, number);
    if (PICK) {
        result.taker = kept[2u * PARTS + number];
        result.largest_id = kept[3u * PARTS + number];
        result.largest_alpha = kept_of(8u, number);
        result.largest_depth = kept_of(9u, number);
    } else {
        result.blue = kept_of(2u, number);
        result.depths = kept_of(3u, number);
    }
    return result;
}

// Keep the numbers of a part for farther slabs, as `resumed` reads them.
fn keep_part(number: u32, part: Part) {
    keep(0u, number, part.red);
    keep(1u, number, part.green);
    keep(4u, number, part.transmittance);
    keep(5u, number, part.open);
    keep(6u, number, part.total);
    keep(7u, number, part.behind);
    if (PICK) {
        kept[2u * PARTS + number] = part.taker;
        kept[3u * PARTS + number] = part.largest_id;
        keep(8u, number, part.largest_alpha);
        keep(9u, number, part.largest_depth);
    } else {
        keep(2u, number, part.blue);
        keep(3u, number, part.depths);
    }
}

// Step 1: initialise the state, and return the range of the tile's pairs.
fn begin_tile(tile: vec2u, local: vec2u) -> vec2u {
    place_pixels(tile, local);
    middle = vec2f(tile * TILE) + 0.5 * f32(TILE) - frame.origin;
    let resumes = CARRIED && frame.resumes != 0u;
    if (resumes) {
        carry(false);
    }
//!repeat PART PARTS
    part_PART = empty_part(PARTu);
    if (resumes) {
        part_PART = resumed(PARTu, part_PART);
    }
//!end
    return ranges[tile.y * image_tiles().x + tile.x];
}

// Step 2: store the light before a cell, and return the most light of any part. A slab that goes on
// within a cell has no other.
fn enter_cell() -> vec4f {
    var most = ZERO;
    let goes_on = CARRIED && frame.resumes == 2u;
//!repeat PART PARTS
    if (!goes_on) {
        part_PART.open = select(ZERO, part_PART.transmittance, part_PART.transmittance >= vec4f(FINISHED));
        part_PART.largest_alpha = ZERO;
    }
    most = max(most, part_PART.open);
//!end
    return most;
}

// Return whether a Gaussian may reach a pixel of the tile: not if all pixels are outside its circle
// or outside the bounding box of its ellipse. Every tile of the cell calls it for every Gaussian.
fn reaches_tile(shape: vec4f, weight: vec4f) -> bool {
    let away = vec2f(nearest(shape.x - middle.x), shape.y - middle.y);
    let outside = max(abs(away) - 0.5 * f32(TILE - 1u), vec2f(0.0));
    let squares = outside * outside;
    let product = shape.z * weight.x;
    let determinant = product - shape.w * shape.w;
    let box = 2.0 * CIRCLE_SLACK * weight.y * vec2f(weight.x, shape.z) / determinant;
    let is_beyond = determinant > FLATTEST * product && any(squares > box + 0.01);
    return weight.y >= 0.0 && squares.x + squares.y <= CIRCLE_SLACK * weight.w && !is_beyond;
}

// Add one Gaussian to one part. factors: 1 / divisor of opacities, weight of the background.
fn added(part: Part, number: u32, id: u32, shape: vec4f, weight: vec4f, color: vec3f, factors: vec2f) -> Part {
    let offset = offset_of(number);
    let dx = nearest(x + f32(offset.x) - shape.x);
    let dy = y + f32(offset.y) - shape.y;
    let bend = 0.5 * weight.x;
    let above = weight.y - 0.5 * shape.z * dx * dx - (bend * dy + shape.w * dx) * dy;
    // Step 1: a Gaussian counts within its circle, where it is opaque enough, and before meshes.
    var is_hit = (above >= ZERO) & (dx * dx + dy * dy <= vec4f(weight.w)) & (part.open > ZERO);
    if (LAYERED) {
        is_hit = is_hit & (vec4f(weight.z) <= part.limit);
    }
    var result = part;
    if (any(is_hit)) {
        // Step 2: weights use the light before the cell, so that the order within it does not matter;
        // the light behind the cell is the product of all.
        let alpha = select(ZERO, factors.x * opacity(above), is_hit);
        let amount = alpha * part.open;
        result.transmittance *= max(1.0 - alpha, ZERO);
        result.total += amount;
        result.behind += amount * factors.y;
        if (LAYERED) {
            result.depths += amount * weight.z;
        }
        if (PICK) {
            let is_larger = alpha > part.largest_alpha;
            result.red += amount * weight.z;
            result.largest_alpha = select(part.largest_alpha, alpha, is_larger);
            result.largest_depth = select(part.largest_depth, vec4f(weight.z), is_larger);
            result.largest_id = select(part.largest_id, vec4u(id), is_larger);
        } else {
            result.red += amount * color.x;
            result.green += amount * color.y;
            result.blue += amount * color.z;
        }
    }
    return result;
}

// Step 3: add one Gaussian of the present cell to all parts.
fn add_splat(id: u32, shape: vec4f, weight: vec4f, color: vec3f, factors: vec2f) {
    // The arrays of a slab have other indices: with PICK, colours are the halves of the scene's there.
    var taker = id;
    if (PICK && CARRIED) {
        taker = (u32(color.x) << 16u) | u32(color.y);
    }
//!repeat PART PARTS
    part_PART = added(part_PART, PARTu, taker, shape, weight, color, factors);
//!end
}

// Step 4: with PICK, store depth and id at pixels where half of the light ends in the cell. A slab that
// ends within a cell does so, too; the next one stores those of the whole cell.
fn leave_cell() {
    if (PICK) {
//!repeat PART PARTS
        let is_halved_PART = (part_PART.open >= vec4f(0.5)) & (part_PART.transmittance < vec4f(0.5));
        part_PART.green = select(part_PART.green, part_PART.largest_depth, is_halved_PART);
        part_PART.taker = select(part_PART.taker, part_PART.largest_id, is_halved_PART);
//!end
    }
}

// Write the pixels of a part over the background, and their depths in a layer.
fn write_part(number: u32, part: Part) {
    let left = part.transmittance;
    let is_met = part.total > ZERO;
    let weight = select(part.behind / part.total, ZERO, left < vec4f(FINISHED));
    let share = select(ZERO, 1.0 / (part.total + weight * left), is_met);  // factor of Σ w c
    let alpha = select(ZERO, part.total * share, is_met);
    let backdrop = select(vec4f(1.0), weight * select(left, vec4f(1.0), PUBLISHED) * share, is_met);
    let depth = select(vec4f(NOWHERE), min(part.depths / part.total, part.limit), is_met);
    let rows = loop_length(4u);
    for (var i = 0u; i < rows; i++) {
        let position = position_of(4u * number + i);
        if (all(position < frame.size)) {
            let index = position.y * frame.size.x + position.x;
            if (LAYERED) {
                layer_depths[index] = depth[i];
            }
            if (PICK) {
                let depths = bitcast<vec2u>(vec2f(part.red[i] * share[i], part.green[i]));
                image[index] = vec4u(depths, part.taker[i], bitcast<u32>(alpha[i]));
            } else {
                let color = vec3f(part.red[i], part.green[i], part.blue[i]) * share[i];
                let blended = vec4f(color + backdrop[i] * frame.background.xyz, alpha[i]);
                image[index] = bitcast<vec4u>(blended);
            }
        }
    }
}

// Step 5: write each pixel over the background; before farther slabs, keep its state instead.
fn end_tile() {
    let continues = CARRIED && frame.continues != 0u;
//!repeat PART PARTS
    if (continues) {
        keep_part(PARTu, part_PART);
    } else {
        write_part(PARTu, part_PART);
    }
//!end
    if (continues) {
        carry(true);
    }
}
