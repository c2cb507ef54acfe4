// Compute and write the splat of a Gaussian whose depth and opacity are known. Comparisons are
// phrased so that NaN is dropped.

//!include splat_record
//!include words
//!include tile_window
//!include flatten
//!include circle
//!include spherical_harmonics

@group(0) @binding(1) var<storage, read_write> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> shapes: array<Quad>;   // mean, conic xx xy
@group(0) @binding(3) var<storage, read_write> weights: array<Quad>;  // conic yy, strength, depth, variance yy (WEIGHTED: radius² of the circle)
@group(0) @binding(4) var<storage, read_write> colors: array<Quad>;   // red, green, blue, number of tiles (if WINDOWS, variance yy)

var<private> window: u32;  // if WINDOWS, the word of the splat that `write_splat` wrote

// Return the offset of a position from the camera centre, in local space.
fn offset_from_eye(position: vec3f) -> vec3f {
    return (position - eye.at) - eye.rest;
}

fn is_in_view(position: vec3f, depth: f32) -> bool {
    let is_inside = all(position >= page.clip_low) && all(position <= page.clip_high);
    return depth > frame.near && depth <= LARGEST && is_inside;
}

fn color_of(own: u32, offset: vec3f) -> vec3f {
    if (page.degree == NO_HARMONICS) {
        return channels(own, 0u).xyz;
    }
    let direction = page.local_to_sh * select(offset, page.forward, is_flat());
    return harmonics(own, page.degree, direction * (1.0 / length(direction)));
}

// Return whether an interval on one axis of the image holds the centre of one of its pixels.
fn holds_a_center(middle: f32, half_extent: f32, size: u32) -> bool {
    let first = ceil(middle - half_extent - 0.5);
    let last = floor(middle + half_extent - 0.5);
    return first <= last && last >= 0.0 && first <= f32(size) - 1.0;
}

// Return whether the box around an ellipse holds a pixel's centre. Tiles do not decide it, because
// devices with tiles of different sizes must draw the same splats.
fn covers_a_pixel(mean: vec2f, half_extent: vec2f) -> bool {
    var half_width = half_extent.x;
    if (PANORAMA) {
        half_width = min(half_width, 0.5 * frame.period + EDGE);
    }
    var is_wide = false;
    for (var copy = FIRST_COPY; copy < FIRST_COPY + COPIES; copy++) {
        let middle = mean.x + (f32(copy) - 1.0) * frame.period;
        is_wide = is_wide || holds_a_center(middle, half_width, frame.size.x);
    }
    return is_wide && holds_a_center(mean.y, half_extent.y, frame.size.y);
}

// Return the number of tiles that an ellipse touches; tiles of two copies count once.
fn tiles_touched(ellipse: Outline) -> u32 {
    var tiles = 0u;
    for (var row = ellipse.rows.x; row < ellipse.rows.y; row++) {
        var listed = 0u;
        for (var copy = FIRST_COPY; copy < FIRST_COPY + COPIES; copy++) {
            let ends = span(ellipse, row, copy);
            tiles += max(ends.y, listed) - max(ends.x, listed);
            listed = max(ends.y, listed);
        }
    }
    return tiles;
}

// Write a splat at `index` that touches no tile.
fn write_empty(index: u32) {
    let empty = quad_of(vec4f(0.0, -LARGEST, 0.0, 0.0));
    if (RECORDS) {
        shapes[weight_at(index)] = empty;
    } else {
        weights[index] = empty;
    }
    colors[index] = quad_of(vec4f(0.0));
}

// Write the splat of row `own` at `index` and return its key, or ABSENT if it is not drawn.
// offset: of the centre from the eye, in local space; at: the centre in camera space; distance: the
// depth that flatten() takes.
fn write_splat(own: u32, index: u32, offset: vec3f, at: vec3f, distance: f32, depth: f32, alpha: f32) -> u32 {
    // Step 1: drop transparent Gaussians.
    if (!(alpha >= CULL_OPACITY && alpha <= LARGEST)) {
        return ABSENT;
    }
    var opacity = min(alpha, 1.0);

    // Step 2: compute the ellipse in the image; antialiasing dims splats thinner than a pixel.
    let flat = flatten(at, distance, read_covariance(own));
    if (!flat.is_valid) {
        return ABSENT;
    }
    if (page.mip != 0u) {
        let bare = flat.bare * flat.inverse_unit;
        let product = bare.x * bare.z - bare.y * bare.y;
        opacity *= sqrt(max(product / flat.determinant, 0.0));
        if (!(opacity >= CULL_OPACITY)) {
            return ABSENT;
        }
    }

    // Step 3: drop ellipses that cover no pixel of the image.
    let strength = log(opacity / CULL_OPACITY);
    if (!covers_a_pixel(flat.mean + frame.origin, sqrt(2.0 * strength * SLACK * flat.dilated.xz) + EDGE)) {
        return ABSENT;
    }

    if (KEYS_ONLY) {
        return bitcast<u32>(depth);
    }

    // Step 4: count the tiles, and compute the colour.
    let scaled = flat.scaled;
    let conic = vec3f(scaled.z, -scaled.y, scaled.x) * (flat.inverse_unit / flat.determinant);
    let ellipse = outline(flat.mean, conic, strength, flat.dilated.z);
    var tiles = 0u;
    if (WINDOWS) {
        window = window_of(ellipse);
    } else {
        tiles = tiles_touched(ellipse);
    }
    let color = color_of(own, offset);
    if (!all(abs(color) <= vec3f(LARGEST))) {
        return ABSENT;
    }

    // Step 5: write.
    var extent = flat.dilated.z;
    if (WEIGHTED) {
        let radius = circle(scaled, flat.determinant, flat.unit, SPLAT_REACH);
        extent = min(radius * radius, LARGEST);
    }
    shapes[shape_at(index)] = quad_of(vec4f(flat.mean, conic.xy));
    let weight = quad_of(vec4f(conic.z, strength, depth, extent));
    if (RECORDS) {
        shapes[weight_at(index)] = weight;
    } else {
        weights[index] = weight;
    }
    let last = select(f32(tiles), flat.dilated.z, WINDOWS);
    colors[index] = quad_of(vec4f(max(color, vec3f(0.0)), last));
    return bitcast<u32>(depth);
}
