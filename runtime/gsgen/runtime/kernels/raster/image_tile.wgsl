// The part of a drawn image that a network sees at once, and how its numbers lie in a tensor.
//
// A tensor has one channel after the other (NCHW), in float32 or, two in a word, in float16. Colours
// are sRGB, not multiplied by alpha, and go from `low` to `high`.

struct ImageTile {
    size: vec2u,       // of the image, pixels
    tile: vec2u,       // of the tensor, pixels
    corner: vec2u,     // the tile's first pixel in the image
    channels: u32,     // of the tensor
    is_linear: u32,    // whether the image has linear colours
    low: f32,          // black in the tensor …
    high: f32,         // … and white
    background_alpha: f32,
}

// Return the alpha of a pixel before a background.
fn alpha_before(pixel: vec4f, background_alpha: f32) -> f32 {
    return clamp(mix(pixel.w, 1.0, background_alpha), 0.0, 1.0);
}
