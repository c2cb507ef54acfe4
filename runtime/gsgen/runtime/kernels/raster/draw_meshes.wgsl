// Draw meshes: the hardware's rasteriser visits the pixels that a triangle may cover, and keeps the
// nearest surface; a pixel's colour and depth come from its ray and the triangle's corners.
//
// Seen along a ray, a corner has an offset to the right of the ray and below it. The areas that
// two corners span with the ray are the barycentric weights of the third at the intersection, even
// for corners behind the camera (Woop et al. 2013).
//
// The rasteriser gets a slightly larger triangle, and the areas decide whether a ray meets it. So
// the rasteriser's grid of corners has no effect, and edges may be curved, as in panoramas.
// Triangles that share an edge leave no gap: both compare the same two products.

//!include mesh_cover
//!include srgb

@group(0) @binding(1) var<storage, read> rays: array<vec2f>;  // of pixel columns, then of rows: a slope, or sine and cosine of an angle
@group(0) @binding(2) var<storage, read> vertices: array<f32>;
@group(0) @binding(3) var<storage, read> faces: array<u32>;
@group(0) @binding(4) var<storage, read> colors: array<f32>;
@group(0) @binding(5) var<storage, read> uvs: array<vec2f>;
@group(0) @binding(6) var picture: texture_2d<f32>;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) @interpolate(flat) face: u32,
    @location(1) @interpolate(flat) a: vec3f,  // the corners in camera space
    @location(2) @interpolate(flat) b: vec3f,
    @location(3) @interpolate(flat) c: vec3f,
    @location(4) @interpolate(flat) upright: vec3f,  // the unit normal; zero without an area
    @location(5) @interpolate(flat) height: f32,     // signed distance of the plane from the camera
}

struct Seen {
    @location(0) color: vec4f,    // red, green, blue, and 1 where a mesh is visible
    @location(1) surface: vec4f,  // normal in camera space, depth
    @builtin(frag_depth) nearness: f32,
}

fn local(vertex: u32) -> vec3f {
    return vec3f(vertices[3u * vertex], vertices[3u * vertex + 1u], vertices[3u * vertex + 2u]);
}

fn offset(at: vec3f) -> vec3f {
    return (at - place.eye) - place.eye_rest;
}

// Return the index of the least of three numbers.
fn least_of(numbers: vec3f) -> u32 {
    let others = select(2u, 1u, numbers.y < numbers.z);
    return select(others, 0u, numbers.x <= min(numbers.y, numbers.z));
}

fn triangle(face: u32) -> Corner {
    let corners = array<vec3f, 3>(local(faces[3u * face]), local(faces[3u * face + 1u]), local(faces[3u * face + 2u]));
    let a = offset(corners[0]);
    let b = offset(corners[1]);
    let c = offset(corners[2]);
    // The plane is computed in local space, before rounding by transforms: its normal from the two
    // shorter edges, its distance from the nearest corner.
    let ab = corners[1] - corners[0];
    let bc = corners[2] - corners[1];
    let ca = corners[0] - corners[2];
    let between = least_of(-vec3f(dot(bc, bc), dot(ca, ca), dot(ab, ab)));
    let edges = array<vec3f, 3>(bc, ca, ab);
    let across = cross(edges[(between + 1u) % 3u], edges[(between + 2u) % 3u]);
    let nearest = least_of(vec3f(dot(a, a), dot(b, b), dot(c, c)));
    let turned = place.upright * across;
    let size = distance_of(turned);
    let has_area = any(across != vec3f(0.0)) && size > 0.0;
    var made: Corner;
    made.face = face;
    made.a = place.linear * a;
    made.b = place.linear * b;
    made.c = place.linear * c;
    made.upright = select(vec3f(0.0), turned / size, has_area);
    made.height = dot(across / size, offset(corners[nearest]));
    return made;
}

@vertex
fn corner_of(@builtin(vertex_index) index: u32) -> Corner {
    var made = triangle(index / CORNERS);
    let pixel = cover(index % CORNERS, made.a, made.b, made.c);
    made.clip = vec4f(2.0 * pixel / place.size - 1.0, 0.5, 1.0);
    made.clip.y = -made.clip.y;
    return made;
}

fn linear_of_srgb(color: vec3f) -> vec3f {
    let curved = pow((color + 0.055) / 1.055, vec3f(2.4));
    return select(curved, color / 12.92, color <= vec3f(0.04045));
}

fn texel(at: vec2i, size: vec2i) -> vec3f {
    return textureLoad(picture, (at + size) % size, 0).xyz;
}

// Interpolate four texels of the repeating texture; hardware samplers would round the weights.
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

// Return the colour of a point of a triangle. weights: barycentric, of the three corners.
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

// Return the offset of a point to the right of a pixel's ray and below it, and its depth.
// across, down: the entries of `rays` for the pixel.
fn beside(at: vec3f, across: vec2f, down: vec2f) -> vec3f {
    if (PANORAMA) {
        let level = across.x * at.x + across.y * at.z;
        let right = across.y * at.x - across.x * at.z;
        return vec3f(right, down.y * at.y - down.x * level, down.x * at.y + down.y * level);
    }
    let slope = vec2f(across.x, down.x);
    return vec3f(at.xy - slope * select(at.z, 1.0, place.is_flat == 1u), at.z);
}

fn direction(across: vec2f, down: vec2f) -> vec3f {
    if (PANORAMA) {
        return vec3f(across.x * down.y, down.x, across.y * down.y);
    }
    return select(vec3f(across.x, down.x, 1.0), vec3f(0.0, 0.0, 1.0), place.is_flat == 1u);
}

@fragment
fn seen_at(corner: Corner) -> Seen {
    let pixel = vec2u(corner.clip.xy);
    let across = rays[pixel.x];
    let down = rays[u32(place.size.x) + pixel.y];
    let a = beside(corner.a, across, down);
    let b = beside(corner.b, across, down);
    let c = beside(corner.c, across, down);
    let ahead = vec3f(b.x * c.y, c.x * a.y, a.x * b.y);
    let back = vec3f(b.y * c.x, c.y * a.x, a.y * b.x);
    if (!(all(ahead >= back) || all(ahead <= back))) {
        discard;
    }
    let areas = ahead - back;
    let weights = areas / (areas.x + areas.y + areas.z);
    let ray = direction(across, down);
    let toward = dot(corner.upright, ray);
    let start = select(vec3f(0.0), vec3f(across.x, down.x, 0.0), place.is_flat == 1u);
    let least = min(a.z, min(b.z, c.z));
    let most = max(a.z, max(b.z, c.z));
    let met = (corner.height - dot(corner.upright, start)) / toward;
    let mean = weights.x * a.z + weights.y * b.z + weights.z * c.z;
    let depth = select(clamp(met, least, most), mean, most - least < mean);
    if (!(depth > place.near && abs(toward) > 0.0)) {
        discard;
    }
    var made: Seen;
    let shade = select(1.0, AMBIENT + (1.0 - AMBIENT) * abs(toward) / length(ray), place.shaded == 1u);
    made.color = vec4f(shade * color_at(corner.face, weights), 1.0);
    made.surface = vec4f(select(corner.upright, -corner.upright, toward > 0.0), depth);
    made.nearness = place.near / depth;
    return made;
}
