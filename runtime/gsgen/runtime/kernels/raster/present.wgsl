// Present: show a drawn image on a surface whose bytes are sRGB.
//
// One triangle covers the surface. The meaning of an image's four words depends on the mode; they
// are as blend_tiles.wgsl writes them. Depths are grey: near is bright, and pixels without a depth
// are black. Normals are shown as (n + 1) / 2 in world space. A coarse image is enlarged smoothly:
// the colours of the four nearest pixels are blended.

//!include srgb
//!include surface

struct Showing {
    turn: mat3x3f,  // camera → world
    size: vec2f,    // of the image, in pixels
    scale: vec2f,   // pixels of the image per pixel of the surface
    row: u32,       // pixels from one row to the next
    mode: u32,
    near: f32,      // the depth shown white
    far: f32,       // the depth shown nearly black
    is_linear: u32,
    first: u32,     // first row of the image that its buffer holds
    background_alpha: f32,
}

@group(0) @binding(0) var<uniform> showing: Showing;
@group(0) @binding(1) var<storage, read> image: array<vec4f>;

@vertex
fn corner_of(@builtin(vertex_index) corner: u32) -> @builtin(position) vec4f {
    return covering(corner);
}

@fragment
fn color_at(@builtin(position) place: vec4f) -> @location(0) vec4f {
    let at = place.xy * showing.scale;
    if (all(showing.scale >= vec2f(1.0))) {
        return pixel_color(floor(at));
    }
    let corner = floor(at - 0.5);
    let share = at - 0.5 - corner;
    let upper = mix(pixel_color(corner), pixel_color(corner + vec2f(1.0, 0.0)), share.x);
    let lower = mix(pixel_color(corner + vec2f(0.0, 1.0)), pixel_color(corner + 1.0), share.x);
    return mix(upper, lower, share.y);
}

// Return what the surface shows of a pixel of the image, or of the nearest one.
fn pixel_color(column_row: vec2f) -> vec4f {
    let end = showing.first + arrayLength(&image) / showing.row;
    let last = min(showing.size - 1.0, vec2f(showing.size.x, f32(end) - 1.0));
    let at = vec2u(clamp(column_row, vec2f(0.0, f32(showing.first)), last));
    let pixel = image[(at.y - showing.first) * showing.row + at.x];
    switch showing.mode {
        case MODE_DEPTH: {
            return grey(select(0.0, pixel.x / pixel.w, pixel.w > 0.0));
        }
        case MODE_MEDIAN: {
            return grey(pixel.y);
        }
        case MODE_NORMAL: {
            let normal = showing.turn * pixel.xyz;
            let size = length(normal);
            let shown = select(vec3f(0.0), (normal / size + 1.0) / 2.0, size > 0.0);
            return vec4f(shown, 1.0);
        }
        case MODE_ALPHA: {
            return vec4f(pixel.www, 1.0);
        }
        default: {
            // Colours are multiplied by alpha, and so are those of the surface.
            let color = clamp(pixel.rgb, vec3f(0.0), vec3f(1.0));
            let alpha = clamp(mix(pixel.w, 1.0, showing.background_alpha), 0.0, 1.0);
            let straight = clamp(color / max(alpha, 1e-6), vec3f(0.0), vec3f(1.0));
            return vec4f(select(color, srgb_of_linear(straight) * alpha, showing.is_linear == 1u), alpha);
        }
    }
}

// Return the grey of a depth; 0 means that the pixel has no depth.
fn grey(depth: f32) -> vec4f {
    let share = clamp((depth - showing.near) / max(showing.far - showing.near, 1e-12), 0.0, 1.0);
    return vec4f(vec3f(select(0.0, 1.0 - 0.9 * share, depth > 0.0)), 1.0);
}
