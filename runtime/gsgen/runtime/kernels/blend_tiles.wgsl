// Blend: composite each tile's splats, front to back.
//
// One workgroup per tile; each invocation has PIXELS vertical neighbours, so that a splat is read
// once for all of them.

//!include frame
//!include splat

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read> shapes: array<vec4f>;
@group(0) @binding(4) var<storage, read> weights: array<vec4f>;
@group(0) @binding(5) var<storage, read> colors: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> image: array<vec4f>;

const PIXELS = 4u;

@compute @workgroup_size(TILE, TILE / PIXELS)
fn blend(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let range = ranges[tile.y * frame.tiles.x + tile.x];
    let column = tile.x * TILE + local.x;
    let row = tile.y * TILE + local.y * PIXELS;
    let x = f32(column) + 0.5 - frame.origin.x;
    let y = f32(row) + 0.5 - frame.origin.y + vec4f(0.0, 1.0, 2.0, 3.0);

    var through = vec4f(1.0);  // transmittance
    var red = vec4f(0.0);
    var green = vec4f(0.0);
    var blue = vec4f(0.0);
    var live = vec4<bool>(true);
    for (var pair = range.x; pair < range.y; pair++) {
        let id = pair_splats[pair];
        let shape = shapes[id];
        let weight = weights[id];
        let dx = x - shape.x;
        let dy = y - shape.y;
        let power = 0.5 * (shape.z * dx * dx + weight.x * dy * dy) + shape.w * dx * dy;
        let alpha = min(weight.y * exp(-power), vec4f(MAX_ALPHA));
        let next = through * (1.0 - alpha);
        let hit = live & (power >= vec4f(0.0)) & (alpha >= vec4f(CULL_OPACITY));
        let enough = next > vec4f(MIN_TRANSMITTANCE);
        live = live & (!hit | enough);
        let drawn = hit & enough;
        let amount = select(vec4f(0.0), alpha * through, drawn);
        through = select(through, next, drawn);
        let color = colors[id];
        red += amount * color.x;
        green += amount * color.y;
        blue += amount * color.z;
        if (!any(live)) {
            break;
        }
    }
    red += through * frame.background.x;
    green += through * frame.background.y;
    blue += through * frame.background.z;
    let alpha = 1.0 - through * (1.0 - frame.background.w);
    for (var i = 0u; i < PIXELS; i++) {
        if (column < frame.size.x && row + i < frame.size.y) {
            image[(row + i) * frame.size.x + column] = vec4f(red[i], green[i], blue[i], alpha[i]);
        }
    }
}
