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

// Depths of four pixels of a layer above each other; NOWHERE outside of the image.
fn depths_of_layer(layer: u32, corner: vec2u) -> vec4f {
    let size = frame.size;
    let at = (layer * size.y + corner.y) * size.x + corner.x;
    var made = vec4f(NOWHERE);
    for (var i = 0u; i < 4u; i++) {
        if (corner.x < size.x && corner.y + i < size.y) {
            made[i] = min(layer_depths[at + i * size.x], NOWHERE);
        }
    }
    return made;
}
//!end
