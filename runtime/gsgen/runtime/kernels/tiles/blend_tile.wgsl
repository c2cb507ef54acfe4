// The state of an invocation that blends a tile, and the three steps of both entry files:
// `begin_tile`, `blend_splat` for every splat, nearest first, and `end_tile`.
//
// `repeat` declares a variable for each cell: on Mesa's llvmpipe, blending with an array of cells took
// 2.1 times as long with subgroups, 2.6 without. An array of layers took 1.0 and 1.2 times as long.

//!include blend_opacity
//!include splat_record
//!include tile_pixels
//!include words

@group(0) @binding(1) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read> shapes: array<Quad>;
@group(0) @binding(4) var<storage, read> weights: array<Quad>;
@group(0) @binding(5) var<storage, read> colors: array<Quad>;
@group(0) @binding(6) var<storage, read_write> image: array<vec4u>;

// LAYERS images among the splats, front to back: see `Layers` in blend_tiles.py. Without layers no
// entry point uses the second bind group. If CARRIED, `layer_depths` go on with the light that
// reaches each pixel of each layer, once per output.
@group(1) @binding(0) var<storage, read> layers: array<vec4f>;
@group(1) @binding(1) var<storage, read_write> layer_depths: array<f32>;


const ZERO = vec4f(0.0);

struct Cell {
    transmittance: vec4f,  // light that still passes; negative once the pixel is finished
    red: vec4f,            // with PICK: Σ w z
    green: vec4f,          // with PICK: the median depth, where half of the light is gone
    blue: vec4f,
    taker: vec4u,          // with PICK: the Gaussian at the median depth
}

// The four pixels of a cell in one layer.
struct LayerCell {
    depth: vec4f,
    transmittance: vec4f,
    light: vec4f,          // light that reaches the layer; negative until a splat behind it is met
}

var<private> lights: array<vec4f, max(LAYERS * CELLS, 1u)>;  // light per layer and cell at the end
//!repeat CELL CELLS
var<private> cell_CELL: Cell;
//!repeat LAYER LAYERS
var<private> layer_LAYER_CELL: LayerCell;
//!end
//!end

// Return what a layer has at a cell before the first splat of a slab. Pixels beyond the image repeat
// its edge.
fn layer_cell(layer: u32, cell: u32) -> LayerCell {
    var result = LayerCell(vec4f(NOWHERE), vec4f(1.0), vec4f(-1.0));
    let rows = loop_length(4u);
    for (var i = 0u; i < rows; i++) {
        let position = position_of(4u * cell + i);
        let nearest = min(position, frame.size - 1u);
        let index = (layer * frame.size.y + nearest.y) * frame.size.x + nearest.x;
        result.depth[i] = min(layer_depths[index], NOWHERE);
        result.transmittance[i] = 1.0 - layers[index].a;
        if (CARRIED && frame.resumes != 0u && all(position < frame.size)) {
            result.light[i] = layer_depths[index + CARRIED_OUTPUT * LAYERS * frame.size.y * frame.size.x];
        }
    }
    return result;
}

// Keep the light of all layers for farther slabs.
fn keep_lights() {
    let pixels = loop_length(4u * CELLS * LAYERS);
    for (var pixel = 0u; pixel < pixels; pixel++) {
        let cell = pixel / 4u;
        let position = position_of(pixel % (4u * CELLS));
        if (all(position < frame.size)) {
            let line = (CARRIED_OUTPUT * LAYERS + cell / CELLS) * frame.size.y + position.y;
            layer_depths[line * frame.size.x + position.x] = lights[cell][pixel % 4u];
        }
    }
}

// Return the state of a cell that `write_cell` kept after nearer splats.
fn read_cell(number: u32) -> Cell {
    var cell = Cell(vec4f(1.0), ZERO, ZERO, ZERO, vec4u(ABSENT));
    let rows = loop_length(4u);
    for (var i = 0u; i < rows; i++) {
        let position = position_of(4u * number + i);
        if (all(position < frame.size)) {
            let state = image[position.y * frame.size.x + position.x];
            let numbers = bitcast<vec4f>(state);
            cell.red[i] = numbers.x;
            cell.green[i] = numbers.y;
            cell.blue[i] = select(numbers.z, 0.0, PICK);
            cell.taker[i] = state.z;
            cell.transmittance[i] = numbers.w;
        }
    }
    return cell;
}

// Return the state of a pixel of a cell.
fn state_of(cell: Cell, i: u32) -> vec4u {
    let third = select(bitcast<u32>(cell.blue[i]), cell.taker[i], PICK);
    let numbers = bitcast<vec3u>(vec3f(cell.red[i], cell.green[i], cell.transmittance[i]));
    return vec4u(numbers.xy, third, numbers.z);
}

// Step 1: initialise the state, and return the range of the tile's pairs.
fn begin_tile(tile: vec2u, local: vec2u) -> vec2u {
    place_pixels(tile, local);
//!repeat CELL CELLS
    cell_CELL = Cell(vec4f(1.0), ZERO, ZERO, ZERO, vec4u(ABSENT));
    if (CARRIED && frame.resumes != 0u) {
        cell_CELL = read_cell(CELLu);
    }
//!repeat LAYER LAYERS
    layer_LAYER_CELL = layer_cell(LAYERu, CELLu);
//!end
//!end
    return ranges[tile.y * image_tiles().x + tile.x];
}

// Return the logarithm of a splat's opacity over CULL_OPACITY at the pixels of a cell.
fn strength_at(cell: u32, shape: vec4f, weight: vec3f) -> vec4f {
    let offset = offset_of(cell);
    let dx = nearest(x + f32(offset.x) - shape.x);
    let dy = y + f32(offset.y) - shape.y;
    let bend = 0.5 * weight.x;
    return weight.y - 0.5 * shape.z * dx * dx - (bend * dy + shape.w * dx) * dy;
}

// Return the light that reaches a layer, updated before a splat at `depth` is blended.
fn light_before(layer: LayerCell, cell: Cell, depth: f32) -> vec4f {
    let is_met = (vec4f(depth) > layer.depth) & (layer.light < ZERO);
    return select(layer.light, abs(cell.transmittance), is_met);
}

// Return the transmittance of a layer at pixels where its light has just been set.
fn passed_by(layer: LayerCell, light: vec4f) -> vec4f {
    return select(vec4f(1.0), layer.transmittance, (layer.light < ZERO) & (light >= ZERO));
}

// Blend one splat over one cell, with opacities that are 0 at pixels which it does not reach. A
// transmittance below MIN_TRANSMITTANCE finishes the pixel.
fn blended(cell: Cell, alpha: vec4f, id: u32, depth: f32, color: vec3f) -> Cell {
    var result = cell;
    // At a finished pixel all three are negative.
    // Step 1: the splat takes a share of the light that is left, if enough remains behind it.
    let before = cell.transmittance;
    let share = alpha * before;
    let after = before - share;
    let is_open = after > vec4f(MIN_TRANSMITTANCE);
    let amount = select(ZERO, share, is_open);
    // Step 2: its colour, or its depth, is weighted by that share.
    if (PICK) {
        let is_halved = (before >= vec4f(0.5)) & (after < vec4f(0.5));
        result.red += amount * depth;
        result.green = select(cell.green, vec4f(depth), is_halved);
        // The arrays of a slab have other indices: there colours are the halves of the scene's.
        let taker = select(id, (u32(color.x) << 16u) | u32(color.y), CARRIED);
        result.taker = select(cell.taker, vec4u(taker), is_halved);
    } else {
        result.red += amount * color.x;
        result.green += amount * color.y;
        result.blue += amount * color.z;
    }
    // Step 3: the sign finishes a pixel, and its amount stays for the background.
    result.transmittance = select(-abs(cell.transmittance), after, is_open);
    return result;
}

//!repeat CELL CELLS
fn blend_cell_CELL(alpha: vec4f, id: u32, depth: f32, color: vec3f) {
//!repeat LAYER LAYERS
    let light_LAYER = light_before(layer_LAYER_CELL, cell_CELL, depth);
    cell_CELL.transmittance *= passed_by(layer_LAYER_CELL, light_LAYER);
    layer_LAYER_CELL.light = light_LAYER;
//!end
    cell_CELL = blended(cell_CELL, alpha, id, depth, color);
}

//!end
// Step 2: blend one splat over all cells.
fn blend_splat(id: u32, shape: vec4f, weight: vec3f, color: vec3f) {
//!repeat CELL CELLS
    {
        let above = strength_at(CELLu, shape, weight);
        if (any(above >= ZERO)) {
            blend_cell_CELL(select(ZERO, opacity(above), above >= ZERO), id, weight.z, color);
        }
    }
//!end
}

// Return a bit for each cell with an unfinished pixel.
fn open_cells() -> u32 {
    var open = 0u;
//!repeat CELL CELLS
    open |= select(0u, 1u << CELLu, any(cell_CELL.transmittance > ZERO));
//!end
    return open;
}

// Return true while a pixel is not finished.
fn is_open() -> bool {
    var most = ZERO;
//!repeat CELL CELLS
    most = max(most, cell_CELL.transmittance);
//!end
    return any(most > ZERO);
}

// Blend a layer at pixels where it is behind all splats: it gets the remaining light, which at a
// finished pixel is a small remainder, as the background does.
fn ended(cell: Cell, layer: LayerCell, light: vec4f, is_last: vec4<bool>) -> Cell {
    var result = cell;
    result.transmittance *= select(vec4f(1.0), layer.transmittance, is_last);
    if (PICK) {
        let passed = light * layer.transmittance;
        let is_halved = (light >= vec4f(0.5)) & (passed < vec4f(0.5));
        result.red += (light - passed) * layer.depth;
        result.green = select(cell.green, layer.depth, is_halved);
    }
    return result;
}

// Return what the image holds for a state: a colour, or depths and a Gaussian.
fn shown(state: vec4u) -> vec4u {
    let numbers = bitcast<vec4f>(state);
    let rest = abs(numbers.w);
    if (PICK) {
        return vec4u(state.xyz, bitcast<u32>(1.0 - rest));
    }
    return bitcast<vec4u>(vec4f(numbers.xyz, 1.0 - rest) + rest * frame.background);
}

// Write the pixels of a cell; their states are kept for farther slabs.
fn write_cell(number: u32, cell: Cell, continues: bool) {
    let rows = loop_length(4u);
    for (var i = 0u; i < rows; i++) {
        let position = position_of(4u * number + i);
        if (all(position < frame.size)) {
            let state = state_of(cell, i);
            let index = position.y * frame.size.x + position.x;
            if (continues) {
                image[index] = state;
            } else {
                image[index] = shown(state);
            }
        }
    }
}

// Add a layer's colours to the image.
fn add_layer(layer: u32) {
    let pixels = loop_length(4u * CELLS);
    for (var pixel = 0u; pixel < pixels; pixel++) {
        let position = position_of(pixel);
        if (all(position < frame.size)) {
            let index = position.y * frame.size.x + position.x;
            let shown = layers[layer * frame.size.x * frame.size.y + index];
            let light = lights[layer * CELLS + pixel / 4u][pixel % 4u];
            image[index] = bitcast<vec4u>(bitcast<vec4f>(image[index]) + light * vec4f(shown.xyz, 0.0));
        }
    }
}

// Step 3: write each pixel over the background, and then the layers' colours; before farther
// slabs, keep its state instead.
fn end_tile() {
    let continues = CARRIED && frame.continues != 0u;
//!repeat CELL CELLS
//!repeat LAYER LAYERS
    if (continues) {
        lights[LAYERu * CELLS + CELLu] = layer_LAYER_CELL.light;
    } else {
        let layer = layer_LAYER_CELL;
        let is_last = (layer.depth < vec4f(NOWHERE)) & (layer.light < ZERO);
        let light = select(max(layer.light, ZERO), abs(cell_CELL.transmittance), is_last);
        cell_CELL = ended(cell_CELL, layer, light, is_last);
        lights[LAYERu * CELLS + CELLu] = light;
    }
//!end
    write_cell(CELLu, cell_CELL, continues);
//!end
//!repeat LAYER LAYERS
    if (continues && LAYERu == 0u) {
        keep_lights();
    } else if (!continues && !PICK) {
        add_layer(LAYERu);
    }
//!end
}
