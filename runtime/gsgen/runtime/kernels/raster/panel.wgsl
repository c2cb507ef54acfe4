// Panel: draw a small image over a surface, pixel by pixel.
//
// The viewport of the pass is the panel's rectangle; colours are multiplied by their alpha.

//!include surface

@group(0) @binding(0) var<uniform> origin: vec4f;  // of the panel, from the upper left corner
@group(0) @binding(1) var picture: texture_2d<f32>;

@vertex
fn corner_of(@builtin(vertex_index) corner: u32) -> @builtin(position) vec4f {
    return covering(corner);
}

@fragment
fn color_at(@builtin(position) place: vec4f) -> @location(0) vec4f {
    return textureLoad(picture, vec2i(floor(place.xy - origin.xy)), 0);
}
