// Draw meshes: the hardware's rasteriser says which pixels a triangle covers; what is seen there is
// worked out from the pixel's ray and the triangle's plane.
//
// So depths do not suffer from the grid that rasterisers snap corners to, and are the same on
// every driver. Möller & Trumbore 1997, with the ray's origin at the depth of the first corner,
// where little is cancelled.

struct Place {
    linear: mat3x3f,     // local → camera, without the translation
    eye: vec3f,          // the camera centre in local space, rounded …
    shaded: u32,         // 1: by a light at the camera
    eye_rest: vec3f,     // … and what the rounding left
    conversion: u32,     // of colours: 1 to linear, 2 to sRGB
    focal: vec2f,        // pixels
    center: vec2f,       // principal point, pixels
    size: vec2f,         // of the image, pixels
    near: f32,
    is_flat: u32,        // 1: an orthographic camera
    textured: u32,
}

@group(0) @binding(0) var<uniform> place: Place;
@group(0) @binding(1) var<storage, read> vertices: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read> colors: array<f32>;
@group(0) @binding(4) var<storage, read> uvs: array<vec2f>;
@group(0) @binding(5) var picture: texture_2d<f32>;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) @interpolate(flat) face: u32,
    @location(1) @interpolate(flat) a: vec3f,  // the corners in camera space
    @location(2) @interpolate(flat) b: vec3f,
    @location(3) @interpolate(flat) c: vec3f,
}

struct Seen {
    @location(0) color: vec4f,    // and 1 where a mesh is
    @location(1) surface: vec4f,  // normal in camera space, depth along +z
    @builtin(frag_depth) nearness: f32,
}

fn in_camera(vertex: u32) -> vec3f {
    let at = vec3f(vertices[3u * vertex], vertices[3u * vertex + 1u], vertices[3u * vertex + 2u]);
    return place.linear * ((at - place.eye) - place.eye_rest);
}

@vertex
fn corner_of(@builtin(vertex_index) index: u32) -> Corner {
    let face = index / 3u;
    var made: Corner;
    made.face = face;
    made.a = in_camera(faces[3u * face]);
    made.b = in_camera(faces[3u * face + 1u]);
    made.c = in_camera(faces[3u * face + 2u]);
    let which = index % 3u;
    let at = select(select(made.c, made.b, which == 1u), made.a, which == 0u);
    if (place.is_flat == 1u) {
        // Nothing divides by depth, so pixels can be left to the fragment shader.
        let pixel = place.focal * at.xy + place.center;
        made.clip = vec4f(2.0 * pixel / place.size - 1.0, 0.5, 1.0);
    } else {
        // near / z is the depth: clipping at z = near, and precise however far.
        let pixel = place.focal * at.xy + place.center * at.z;
        made.clip = vec4f(2.0 * pixel / place.size - at.z, place.near, at.z);
    }
    made.clip.y = -made.clip.y;
    return made;
}

fn linear_of_srgb(color: vec3f) -> vec3f {
    let curved = pow((color + 0.055) / 1.055, vec3f(2.4));
    return select(curved, color / 12.92, color <= vec3f(0.04045));
}

//!include srgb

fn texel(at: vec2i, size: vec2i) -> vec3f {
    return textureLoad(picture, (at + size) % size, 0).xyz;
}

// Between four texels; outside of 0 to 1 the texture repeats. Samplers round their weights.
fn texture_at(uv: vec2f) -> vec3f {
    let size = vec2i(textureDimensions(picture));
    let inside = uv - floor(uv);
    let at = vec2f(inside.x, 1.0 - inside.y) * vec2f(size) - 0.5;
    let low = vec2i(floor(at));
    let share = at - floor(at);
    let upper = mix(texel(low, size), texel(low + vec2i(1, 0), size), share.x);
    let lower = mix(texel(low + vec2i(0, 1), size), texel(low + vec2i(1, 1), size), share.x);
    return mix(upper, lower, share.y);
}

fn color_of(vertex: u32) -> vec3f {
    return vec3f(colors[3u * vertex], colors[3u * vertex + 1u], colors[3u * vertex + 2u]);
}

// weights: of the triangle's three corners.
fn color_at(face: u32, weights: vec3f) -> vec3f {
    let one = vec3u(faces[3u * face], faces[3u * face + 1u], faces[3u * face + 2u]);
    var color = weights.x * color_of(one.x) + weights.y * color_of(one.y) + weights.z * color_of(one.z);
    if (place.textured == 1u) {
        color *= texture_at(weights.x * uvs[one.x] + weights.y * uvs[one.y] + weights.z * uvs[one.z]);
    }
    if (place.conversion == 1u) {
        return linear_of_srgb(color);
    }
    if (place.conversion == 2u) {
        return srgb_of_linear(color);
    }
    return color;
}

@fragment
fn seen_at(corner: Corner) -> Seen {
    let slope = (corner.clip.xy - place.center) / place.focal;
    let is_flat = place.is_flat == 1u;
    let ray = select(vec3f(slope, 1.0), vec3f(0.0, 0.0, 1.0), is_flat);
    let ab = corner.b - corner.a;
    let ac = corner.c - corner.a;
    let across = cross(ab, ac);
    let size = length(across);
    let start = select(corner.a.z * slope, slope, is_flat);
    let offset = vec3f(start - corner.a.xy, 0.0);
    let p = cross(ray, ac);
    let facing = dot(ab, p);
    if (!(size > 0.0 && abs(facing) > 0.0)) {
        discard;
    }
    let q = cross(offset, ab);
    let ahead = corner.a.z + dot(ac, q) / facing;
    // Where the rasteriser has snapped a corner outwards, a steep plane would run away.
    let least = min(min(corner.a.z, corner.b.z), corner.c.z);
    let most = max(max(corner.a.z, corner.b.z), corner.c.z);
    let depth = clamp(ahead, least, most);
    if (!(depth > place.near)) {
        discard;
    }
    let u = clamp(dot(offset, p) / facing, 0.0, 1.0);
    let v = clamp(dot(ray, q) / facing, 0.0, 1.0 - u);
    let upright = across / size;
    let toward = dot(upright, ray);
    var made: Seen;
    let shade = select(1.0, AMBIENT + (1.0 - AMBIENT) * abs(toward) / length(ray), place.shaded == 1u);
    made.color = vec4f(shade * color_at(corner.face, vec3f(1.0 - u - v, u, v)), 1.0);
    made.surface = vec4f(select(upright, -upright, toward > 0.0), depth);
    made.nearness = place.near / depth;
    return made;
}
