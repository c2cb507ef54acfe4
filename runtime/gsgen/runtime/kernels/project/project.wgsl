// Project: turn the Gaussians of one page into splats, and say how far away each is.
//
// One invocation per Gaussian. A Gaussian that is not drawn gets the key ABSENT and no splat.
// Comparisons are phrased so that NaN is dropped.

//!include frame

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read_write> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> shapes: array<vec4f>;   // mean, conic xx xy
@group(0) @binding(3) var<storage, read_write> weights: array<vec4f>;  // conic yy, strength, depth, variance yy; WEIGHTED: its circle's radius² at the end
@group(0) @binding(4) var<storage, read_write> colors: array<vec4f>;   // red, green, blue, and how many tiles
//!repeat ONCE SORTED
@group(0) @binding(5) var<storage, read_write> lows: array<u32>;       // the rest of depths, as bits that sort as it does
//!end

@group(1) @binding(0) var<uniform> page: Page;
@group(1) @binding(1) var<storage, read> rows: array<vec2u>;
@group(1) @binding(2) var<storage, read> appearance: array<vec4u>;
//!repeat ONCE WEIGHTED
@group(1) @binding(3) var<storage, read> cells: array<vec2f>;  // five pairs a cell; the second ends in its visibility
//!end

//!include page
//!include tile_span
//!include panorama
//!include flatten
//!include exact_depth
//!include circle

var<private> own: u32;  // the row of this invocation's Gaussian
var<private> low: u32;  // and what its key leaves of its depth

fn channels(group: u32) -> vec4f {
    if (HALF_APPEARANCE && STRIDE == 0u) {
        let two = appearance[own / 2u];
        let four = select(two.xy, two.zw, own % 2u == 1u);
        return vec4f(unpack2x16float(four.x), unpack2x16float(four.y));
    }
    if (HALF_APPEARANCE) {
        let eight = appearance[own * STRIDE + group / 2u];
        let four = select(eight.xy, eight.zw, group % 2u == 1u);
        return vec4f(unpack2x16float(four.x), unpack2x16float(four.y));
    }
    return bitcast<vec4f>(appearance[own * STRIDE + group]);
}

fn coefficients(quad: u32) -> array<vec3f, 4> {
    let a = channels(3u * quad);
    let b = channels(3u * quad + 1u);
    let c = channels(3u * quad + 2u);
    return array<vec3f, 4>(a.xyz, vec3f(a.w, b.xy), vec3f(b.zw, c.x), c.yzw);
}

//!include spherical_harmonics

fn color_of(offset: vec3f) -> vec3f {
    if (page.degree == NO_HARMONICS) {
        return channels(0u).xyz;
    }
    let direction = page.local_to_sh * select(offset, page.forward, is_flat());
    return harmonics(page.degree, direction / length(direction));
}

// Write the splat of this invocation's Gaussian, and return its key.
fn splat_key(index: u32) -> u32 {
    let center = read_center(own);
    let offset = (center.position - page.eye) - page.eye_rest;
    var at = page.linear * offset;
    let inside = all(center.position >= page.clip_low) && all(center.position <= page.clip_high);
    let distance = depth_of(at);
    var depth = distance;
//!repeat ONCE SORTED
    let exact = exact_depth(center.position, distance);
    depth = exact.x;
    low = order_of(exact.y);
    at.z = select(depth, at.z, PANORAMA);
//!end
    if (!(depth > frame.near && depth <= LARGEST && inside)) {
        return ABSENT;
    }
    var opacity = center.opacity * page.opacity_scale;
//!repeat ONCE WEIGHTED
    let cell = (page.first_row + own) / page.per_cell;
    opacity *= cells[5u * cell + 1u].y * (1.0 - depth * page.inverse_range);
//!end
    if (!(opacity >= CULL_OPACITY && opacity <= LARGEST)) {
        return ABSENT;
    }
    opacity = min(opacity, 1.0);

    let ellipse = flatten(at, distance, read_covariance(own));
    if (!ellipse.sound) {
        return ABSENT;
    }
    if (page.mip != 0u) {
        let bare = ellipse.plain / ellipse.unit;
        let product = bare.x * bare.z - bare.y * bare.y;
        opacity *= sqrt(max(product / ellipse.determinant, 0.0));
        if (!(opacity >= CULL_OPACITY)) {
            return ABSENT;
        }
    }
    let strength = log(opacity / CULL_OPACITY);
    var half_extent = sqrt(2.0 * strength * ellipse.wide.xz);
    if (PANORAMA) {
        half_extent.x = LARGEST;  // it may reach over the seam; `span` knows
    }
    let low = 0.5 - frame.origin;
    let high = vec2f(frame.size) - 0.5 - frame.origin;
    if (!(all(ellipse.mean + half_extent >= low) && all(ellipse.mean - half_extent <= high))) {
        return ABSENT;
    }
    let scaled = ellipse.scaled;
    let conic = vec3f(scaled.z, -scaled.y, scaled.x) / ellipse.determinant / ellipse.unit;
    let made = outline(ellipse.mean, conic, strength, ellipse.wide.z);
    var tiles = 0u;
    for (var line = made.rows.x; line < made.rows.y; line++) {
        var behind = 0u;
//!repeat COPY COPIES
        {
            let ends = span(made, line, COPYu);
            tiles += max(ends.y, behind) - max(ends.x, behind);
            behind = max(ends.y, behind);
        }
//!end
    }
    let color = color_of(offset);
    if (!all(abs(color) <= vec3f(LARGEST)) || tiles == 0u) {
        return ABSENT;
    }
    shapes[index] = vec4f(ellipse.mean, conic.xy);
    var extent = ellipse.wide.z;
    if (WEIGHTED) {
        let radius = circle(scaled, ellipse.determinant, ellipse.unit, SPLAT_REACH);
        extent = min(radius * radius, LARGEST);
    }
    weights[index] = vec4f(conic.z, strength, depth, extent);
    colors[index] = vec4f(max(color, vec3f(0.0)), f32(tiles));
    return bitcast<u32>(depth);
}

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u) {
    own = invocation.x;
    if (own >= page.capacity) {
        return;
    }
    let index = page.base + own;
    var key = ABSENT;
    if (own < page.count) {
        key = splat_key(index);
    }
    keys[index] = key;
//!repeat ONCE SORTED
    lows[index] = select(low, ABSENT, key == ABSENT);
//!end
    if (WEIGHTED && key == ABSENT) {
        weights[index] = vec4f(0.0, -LARGEST, 0.0, 0.0);  // nothing sorts it out
    }
}
