// What both ways to blend bind, and know.

//!include frame

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read> shapes: array<vec4f>;
@group(0) @binding(4) var<storage, read> weights: array<vec4f>;
@group(0) @binding(5) var<storage, read> colors: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> image: array<vec4u>;

const ZERO = vec4f(0.0);

//!include blend_opacity
//!repeat ONCE LAYERED

// Images among the splats, the front one first: see `Layers` in blend_tiles.py.
@group(1) @binding(0) var<storage, read> layers: array<vec4f>;
@group(1) @binding(1) var<storage, read> layer_depths: array<f32>;

const STRIDE = CELLS;  // of layers, in arrays of cells

// Where four pixels of a layer above each other are; those outside of the image are at its edge.
fn places_of_layer(layer: u32, corner: vec2u) -> vec4u {
    let last = frame.size - 1u;
    let rows = min(corner.y + vec4u(0u, 1u, 2u, 3u), vec4u(last.y));
    return (layer * frame.size.y + rows) * frame.size.x + min(corner.x, last.x);
}

fn depths_of_layer(layer: u32, corner: vec2u) -> vec4f {
    let at = places_of_layer(layer, corner);
    let upper = vec2f(layer_depths[at.x], layer_depths[at.y]);
    let lower = vec2f(layer_depths[at.z], layer_depths[at.w]);
    return min(vec4f(upper, lower), vec4f(NOWHERE));
}

fn alphas_of_layer(layer: u32, corner: vec2u) -> vec4f {
    let at = places_of_layer(layer, corner);
    return vec4f(layers[at.x].a, layers[at.y].a, layers[at.z].a, layers[at.w].a);
}
//!end
