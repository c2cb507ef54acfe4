// Import layer: copy the picture and the depth buffer of another renderer to an image layer.
//
// One invocation per pixel. Rows of copied textures are padded. The picture has linear colours in
// float16, multiplied by alpha, or those of the splats; a layer has sRGB colours, multiplied by
// alpha, as splats are blended.

struct Picture {
    size: vec2u,     // of the image, pixels
    color_row: u32,  // pixels of a padded row of the picture …
    depth_row: u32,  // … and of the depth buffer
    first: u32,      // index of the layer's first pixel
    empty: f32,      // the depth buffer's value where nothing is drawn
    slope: f32,      // the depth along +z is offset / (value + slope)
    offset: f32,
    is_encoded: u32,  // whether the picture has the colours of the splats already
}

@group(0) @binding(0) var<uniform> picture: Picture;
@group(0) @binding(1) var<storage, read> halves: array<vec2u>;  // red and green, blue and alpha
@group(0) @binding(2) var<storage, read> values: array<f32>;    // of the depth buffer
@group(0) @binding(3) var<storage, read_write> layers: array<vec4f>;

@group(1) @binding(0) var<storage, read_write> depths: array<f32>;

const BEHIND = 0.5 * NOWHERE;  // the depth of a background, behind all splats

// Return the sRGB encoding of linear colours (IEC 61966-2-1).
fn encoded(linear: vec3f) -> vec3f {
    let curve = 1.055 * pow(linear, vec3f(1.0 / 2.4)) - 0.055;
    return select(curve, 12.92 * linear, linear <= vec3f(0.0031308));
}

@compute @workgroup_size(TILE, TILE)
fn import_layer(@builtin(global_invocation_id) at: vec3u) {
    if (any(at.xy >= picture.size)) {
        return;
    }
    let words = halves[at.y * picture.color_row + at.x];
    let color = vec4f(unpack2x16float(words.x), unpack2x16float(words.y));
    let value = values[at.y * picture.depth_row + at.x];
    let place = picture.first + at.y * picture.size.x + at.x;
    let alpha = clamp(color.a, 0.0, 1.0);
    let straight = clamp(color.rgb / max(alpha, 1e-6), vec3f(0.0), vec3f(1.0));
    let depth = select(picture.offset / (value + picture.slope), BEHIND, value == picture.empty);
    layers[place] = vec4f(alpha * select(encoded(straight), straight, picture.is_encoded == 1u), alpha);
    depths[place] = select(NOWHERE, depth, alpha > 0.0);
}
