// Tensor to image: add the output of a network to an image, and multiply it by alpha.
//
// `add` has one invocation per pixel of a tile. Each tile has a weight at a pixel, the product of
// that of its column and that of its row; those of all tiles sum to 1. `finish` has one invocation
// per pixel of the image. A network of three channels keeps the alpha of the image that it saw.

//!include image_tile

@group(0) @binding(0) var<uniform> region: ImageTile;
@group(0) @binding(1) var<storage, read_write> image: array<vec4f>;  // of the network
@group(0) @binding(2) var<storage, read> words: array<u32>;          // of the tensor
@group(0) @binding(3) var<storage, read> weights: array<f32>;        // of columns, then of rows
@group(0) @binding(4) var<storage, read_write> faults: atomic<u32>;  // numbers that are not finite

@group(1) @binding(0) var<storage, read> seen: array<vec4f>;  // the image before the network

// Return a number of the tensor as float32; others than finite ones are counted.
fn number_at(index: u32) -> f32 {
    var bits = words[select(index, index / 2u, HALF)];
    var exponent = 0x7f800000u;
    if (HALF) {
        bits = (bits >> (16u * (index % 2u))) & 0xffffu;
        exponent = 0x7c00u;
    }
    if ((bits & exponent) == exponent) {
        atomicAdd(&faults, 1u);
        return 0.0;
    }
    if (HALF) {
        return unpack2x16float(bits).x;
    }
    return bitcast<f32>(bits);
}

@compute @workgroup_size(TILE, TILE)
fn add(@builtin(global_invocation_id) id: vec3u) {
    let place = region.corner + id.xy;
    if (any(id.xy >= region.tile) || any(place >= region.size)) {
        return;
    }
    let area = region.tile.x * region.tile.y;
    var color = vec4f(0.0);
    for (var channel = 0u; channel < region.channels; channel++) {
        let number = number_at(channel * area + id.y * region.tile.x + id.x);
        color[channel] = (number - region.low) / (region.high - region.low);
    }
    let weight = weights[id.x] * weights[region.tile.x + id.y];
    image[place.y * region.size.x + place.x] += weight * color;
}

@compute @workgroup_size(TILE, TILE)
fn finish(@builtin(global_invocation_id) id: vec3u) {
    if (any(id.xy >= region.size)) {
        return;
    }
    let place = id.y * region.size.x + id.x;
    let color = image[place];
    var alpha = clamp(color.w, 0.0, 1.0);
    if (region.channels == 3u) {
        alpha = alpha_before(seen[place], region.background_alpha);
    }
    image[place] = vec4f(color.rgb * alpha, alpha);
}
