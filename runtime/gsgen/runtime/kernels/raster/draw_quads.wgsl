// Draw quads: the hardware's rasteriser blends one quad per splat, the farthest first.
//
// The quad bounds the ellipse of the splat. Blending cannot stop at a finished pixel, so this
// shader draws light that blend_tiles.wgsl leaves out.
//
// In a panorama a splat has one quad at its place, and one a full turn to each side: the three are
// one strip, whose joints have no area.

//!include frame
//!include splat_record

@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> shapes: array<vec4f>;
@group(0) @binding(4) var<storage, read> weights: array<vec4f>;
@group(0) @binding(5) var<storage, read> colors: array<vec4f>;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) @interpolate(flat) shape: vec4f,     // mean, conic xx xy
    @location(1) @interpolate(flat) weight: vec2f,    // conic yy, strength
    @location(2) @interpolate(flat) color: vec3f,
}

const SLACK = 1.0001;  // factor of the reach: rounding must not lose a pixel
const EDGE = 0.51;     // pixels around the ellipse: a quad draws pixels whose centres it covers

// Return the number of a corner within its quad, and the number of the quad.
fn corner_and_copy(vertex: u32) -> vec2u {
    if (!PANORAMA) {
        return vec2u(vertex, 1u);
    }
    // A joint repeats the last corner of a quad and the first corner of the next.
    let place = vertex % 6u;
    if (place == 5u) {
        return vec2u(0u, vertex / 6u + 1u);
    }
    return vec2u(min(place, 3u), vertex / 6u);
}

@vertex
fn corner_of(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> Corner {
    let numbers = corner_and_copy(vertex);
    let corner = numbers.x;
    // Step 1: take the farthest splat first: the hardware blends in order, each over those before.
    let id = order[counts[VISIBLE] - 1u - instance];
    var shape = shapes[shape_at(id)];
    if (PANORAMA) {
        shape.x += (f32(numbers.y) - 1.0) * frame.period;
    }
    let weight = weights[weight_at(id)];
    // The covariance, from its yy and the conic.
    let yy = weight.w;
    let xy = -shape.w / shape.z * yy;
    let xx = weight.x / shape.z * yy;
    // Step 2: find the axes of the ellipse, which are the eigenvectors.
    let middle = 0.5 * (xx + yy);
    let apart = sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy);
    var long_axis = vec2f(1.0, 0.0);
    if (apart > 0.0) {
        // The longer of two forms of the eigenvector: the other may vanish.
        long_axis = normalize(select(vec2f(xy, middle + apart - xx), vec2f(middle + apart - yy, xy), xx > yy));
    }
    // Step 3: move the corner along both axes, as far as opacities reach CULL_OPACITY.
    let reach = 2.0 * weight.y * SLACK;
    let length = sqrt(reach * (middle + apart)) + EDGE;
    let width = sqrt(reach * max(middle - apart, 0.0)) + EDGE;
    let side = vec2f(f32(corner & 1u), f32(corner >> 1u)) * 2.0 - 1.0;
    let offset = side.x * length * long_axis + side.y * width * vec2f(-long_axis.y, long_axis.x);
    let pixel = (shape.xy + frame.origin + offset) / vec2f(frame.size);
    // Step 4: the depth of a corner is compared with those of meshes.
    let nearness = select(0.5, frame.near / weight.z, TESTED);  // as draw_meshes.wgsl has it
    let clip = vec4f(2.0 * pixel.x - 1.0, 1.0 - 2.0 * pixel.y, nearness, 1.0);
    return Corner(clip, shape, weight.xy, colors[id].xyz);
}

@fragment
fn color_at(corner: Corner) -> @location(0) vec4f {
    let d = corner.clip.xy - frame.origin - corner.shape.xy;
    let above = corner.weight.y
        - 0.5 * (corner.shape.z * d.x * d.x + corner.weight.x * d.y * d.y)
        - corner.shape.w * d.x * d.y;
    // Beyond half a turn another quad draws the splat.
    if (!(above >= 0.0) || (PANORAMA && abs(d.x) > 0.5 * frame.period)) {
        discard;
    }
    let alpha = min(CULL_OPACITY * exp(above), MAX_ALPHA);
    return vec4f(alpha * corner.color, alpha);
}
