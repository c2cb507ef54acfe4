// Image to tensor: copy a tile of a drawn image into the input of a network.
//
// One invocation per word of the tensor. Beyond the image, its last pixels go on.

//!include image_tile
//!include srgb

@group(0) @binding(0) var<uniform> region: ImageTile;
@group(0) @binding(1) var<storage, read> image: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> words: array<u32>;

// Return a number of the tensor.
fn number_at(index: u32) -> f32 {
    let area = region.tile.x * region.tile.y;
    let channel = index / area;
    let at = vec2u(index % region.tile.x, index % area / region.tile.x);
    let place = min(region.corner + at, region.size - 1u);
    let pixel = image[place.y * region.size.x + place.x];
    let alpha = alpha_before(pixel, region.background_alpha);
    var straight = clamp(pixel.rgb / select(1.0, alpha, alpha > 0.0), vec3f(0.0), vec3f(1.0));
    if (region.is_linear == 1u) {
        straight = srgb_of_linear(straight);
    }
    return mix(region.low, region.high, vec4f(straight, alpha)[channel]);
}

@compute @workgroup_size(THREADS)
fn fill(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let word = id.y * groups.x * THREADS + id.x;
    let count = region.channels * region.tile.x * region.tile.y;
    if (HALF) {
        let first = 2u * word;
        if (first < count) {
            let second = number_at(min(first + 1u, count - 1u));
            words[word] = pack2x16float(vec2f(number_at(first), second));
        }
    } else if (word < count) {
        words[word] = bitcast<u32>(number_at(word));
    }
}
