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

@group(1) @binding(0) var<uniform> page: Page;
@group(1) @binding(1) var<storage, read> rows: array<vec2u>;
@group(1) @binding(2) var<storage, read> appearance: array<vec4u>;
//!repeat ONCE WEIGHTED
@group(1) @binding(3) var<storage, read> cells: array<vec2f>;  // five pairs a cell; the second ends in its visibility
//!end

const LARGEST = 3.4e38;
const LARGEST_VARIANCE = 1e30;  // pixels²; the reciprocal still has all its digits

//!include page
//!include tile_span
//!include panorama
//!include circle

var<private> own: u32;  // the row of this invocation's Gaussian

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
    let at = page.linear * offset;
    let inside = all(center.position >= page.clip_low) && all(center.position <= page.clip_high);
    var depth = at.z;
    if (PANORAMA) {
        depth = distance_of(at);
    }
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

    let inverse = select(1.0 / at.z, 1.0, is_flat());
    let slope = at.xy * inverse;
    let bent = select(clamp(slope, frame.slope_low, frame.slope_high), vec2f(0.0), is_flat());

    // Rows of the Jacobian times the rotation: how the pixel moves with the local position.
    let turned = transpose(page.linear);
    var jx = frame.focal.x * inverse * (turned[0] - bent.x * turned[2]);
    var jy = frame.focal.y * inverse * (turned[1] - bent.y * turned[2]);
    var mean = frame.focal * slope + frame.center;
    if (PANORAMA) {
        let sight = sight_around(at, depth);
        jx = frame.focal.x * (turned * sight.jx);
        jy = frame.focal.y * (turned * sight.jy);
        mean = frame.focal * sight.angles + frame.center;
        let middle = 0.5 * f32(frame.size.x) - frame.origin.x;
        mean.x = middle + nearest(mean.x - middle);
    }
    let sigma = read_covariance(own);
    let sx = sigma * jx;
    let sy = sigma * jy;
    let plain = vec3f(dot(jx, sx), dot(jx, sy), dot(jy, sy));
    let wide = vec3f(plain.x + DILATION, plain.y, plain.z + DILATION);
    // In units of a power of two, so that nothing overflows and nothing is rounded.
    let unit = bitcast<f32>(bitcast<u32>(max(wide.x, wide.z)) & 0x7f800000u);
    let scaled = wide / unit;
    let determinant = scaled.x * scaled.z - scaled.y * scaled.y;
    let sound = wide.x > 0.0 && wide.z > 0.0 && max(wide.x, wide.z) <= LARGEST_VARIANCE;
    if (!(sound && determinant > 0.0)) {
        return ABSENT;
    }

    if (page.mip != 0u) {
        let bare = plain / unit;
        let product = bare.x * bare.z - bare.y * bare.y;
        opacity *= sqrt(max(product / determinant, 0.0));
        if (!(opacity >= CULL_OPACITY)) {
            return ABSENT;
        }
    }
    let strength = log(opacity / CULL_OPACITY);
    var half_extent = sqrt(2.0 * strength * wide.xz);
    if (PANORAMA) {
        half_extent.x = LARGEST;  // it may reach over the seam; `span` knows
    }
    let low = 0.5 - frame.origin;
    let high = vec2f(frame.size) - 0.5 - frame.origin;
    if (!(all(mean + half_extent >= low) && all(mean - half_extent <= high))) {
        return ABSENT;
    }
    let conic = vec3f(scaled.z, -scaled.y, scaled.x) / determinant / unit;
    let made = outline(mean, conic, strength, wide.z);
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
    shapes[index] = vec4f(mean, conic.xy);
    var extent = wide.z;
    if (WEIGHTED) {
        let radius = circle(scaled, determinant, unit, SPLAT_REACH);
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
    if (own < page.count) {
        keys[index] = splat_key(index);
    } else {
        keys[index] = ABSENT;
    }
    if (WEIGHTED && keys[index] == ABSENT) {
        weights[index] = vec4f(0.0, -LARGEST, 0.0, 0.0);  // nothing sorts it out
    }
}
