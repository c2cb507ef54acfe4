// Lay meshes: copy the drawn meshes to a layer for blend_tiles.wgsl.
//
// One invocation per pixel. Rows of a copied texture are padded.

struct Shape {
    size: vec2u,   // of the image, pixels
    row: u32,      // pixels of a row of the copies
    first: u32,    // index of the layer's first pixel
}

@group(0) @binding(0) var<uniform> shape: Shape;
@group(0) @binding(1) var<storage, read> drawn: array<vec4f>;     // red, green, blue, 1 or 0
@group(0) @binding(2) var<storage, read> surfaces: array<vec4f>;  // normal, depth
@group(0) @binding(3) var<storage, read_write> layers: array<vec4f>;

@group(1) @binding(0) var<storage, read_write> depths: array<f32>;

@compute @workgroup_size(TILE, TILE)
fn lay_colors(@builtin(global_invocation_id) at: vec3u) {
    if (any(at.xy >= shape.size)) {
        return;
    }
    let taken = at.y * shape.row + at.x;
    let place = shape.first + at.y * shape.size.x + at.x;
    let color = drawn[taken];
    let is_there = color.a > 0.5;
    layers[place] = select(vec4f(0.0), color, is_there);
    depths[place] = select(NOWHERE, surfaces[taken].w, is_there);
}

@compute @workgroup_size(TILE, TILE)
fn lay_normals(@builtin(global_invocation_id) at: vec3u) {
    if (any(at.xy >= shape.size)) {
        return;
    }
    let taken = at.y * shape.row + at.x;
    let is_there = drawn[taken].a > 0.5;
    layers[shape.first + at.y * shape.size.x + at.x] =
        select(vec4f(0.0), vec4f(surfaces[taken].xyz, 1.0), is_there);
}
