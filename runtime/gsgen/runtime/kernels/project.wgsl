// Project: turn the Gaussians of one page into splats, and say how far away each is.
//
// One invocation per Gaussian. A Gaussian that is not drawn gets the key ABSENT and no splat.
// Comparisons are phrased so that NaN is dropped.

//!include frame
//!include splat

struct Page {
    linear: mat3x3f,      // local → camera, without the translation
    local_to_sh: mat3x3f, // local offset from the eye → direction that the harmonics were fitted for
    eye: vec3f,           // the camera centre in local space, rounded …
    opacity_scale: f32,
    eye_rest: vec3f,      // … and what the rounding left
    base: u32,            // index of the page's first Gaussian in the frame
    clip_low: vec3f,      // local box outside of which centres are not drawn
    count: u32,           // live Gaussians of the page
    clip_high: vec3f,
    degree: u32,          // of the harmonics; RGB where it is NO_HARMONICS
    mip: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read_write> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> shapes: array<vec4f>;   // mean, conic xx xy
@group(0) @binding(3) var<storage, read_write> weights: array<vec4f>;  // conic yy, opacity, depth, variance yy
@group(0) @binding(4) var<storage, read_write> colors: array<vec4f>;   // rgb, variance xx

@group(1) @binding(0) var<uniform> page: Page;
@group(1) @binding(1) var<storage, read> rows: array<u32>;
@group(1) @binding(2) var<storage, read> appearance: array<u32>;

const LARGEST = 3.4e38;

var<private> own: u32;  // the row of this invocation's Gaussian

fn row_value(column: u32) -> f32 {
    if (HALF_ROWS) {
        return unpack2x16float(rows[own * (ROW / 2u) + column / 2u])[column % 2u];
    }
    return bitcast<f32>(rows[own * ROW + column]);
}

fn appearance_value(column: u32) -> f32 {
    if (HALF_APPEARANCE) {
        let at = own * CHANNELS + column;
        return unpack2x16float(appearance[at / 2u])[at % 2u];
    }
    return bitcast<f32>(appearance[own * CHANNELS + column]);
}

fn coefficient(index: u32) -> vec3f {
    return vec3f(
        appearance_value(3u * index), appearance_value(3u * index + 1u), appearance_value(3u * index + 2u)
    );
}

//!include spherical_harmonics

fn color_of(offset: vec3f) -> vec3f {
    if (page.degree == NO_HARMONICS) {
        return coefficient(0u);
    }
    let direction = page.local_to_sh * offset;
    return harmonics(page.degree, direction / length(direction));
}

@compute @workgroup_size(THREADS)
fn project(@builtin(global_invocation_id) invocation: vec3u) {
    own = invocation.x;
    if (own >= page.count) {
        return;
    }
    let index = page.base + own;
    keys[index] = ABSENT;

    let position = vec3f(row_value(0u), row_value(1u), row_value(2u));
    let offset = (position - page.eye) - page.eye_rest;
    let at = page.linear * offset;
    let inside = all(position >= page.clip_low) && all(position <= page.clip_high);
    if (!(at.z > frame.near && at.z <= LARGEST && inside)) {
        return;
    }
    let inverse = 1.0 / at.z;
    let slope = at.xy * inverse;
    let bent = clamp(slope, frame.slope_low, frame.slope_high);
    let along_x = frame.focal.x * inverse;
    let along_y = frame.focal.y * inverse;

    // Rows of the Jacobian times the rotation: how the pixel moves with the local position.
    let turned = transpose(page.linear);
    let jx = along_x * (turned[0] - bent.x * turned[2]);
    let jy = along_y * (turned[1] - bent.y * turned[2]);
    let xx = row_value(4u);
    let xy = row_value(5u);
    let xz = row_value(6u);
    let yy = row_value(7u);
    let yz = row_value(8u);
    let zz = row_value(9u);
    let sigma = mat3x3f(vec3f(xx, xy, xz), vec3f(xy, yy, yz), vec3f(xz, yz, zz));
    let sx = sigma * jx;
    let sy = sigma * jy;
    let plain = vec3f(dot(jx, sx), dot(jx, sy), dot(jy, sy));
    let wide = vec3f(plain.x + DILATION, plain.y, plain.z + DILATION);
    let determinant = wide.x * wide.z - wide.y * wide.y;
    if (!(wide.x > 0.0 && wide.z > 0.0 && determinant > 0.0 && determinant <= LARGEST)) {
        return;
    }

    var opacity = row_value(3u) * page.opacity_scale;
    if (!(opacity >= CULL_OPACITY && opacity <= LARGEST)) {
        return;
    }
    opacity = min(opacity, 1.0);
    if (page.mip != 0u) {
        opacity *= sqrt(max((plain.x * plain.z - plain.y * plain.y) / determinant, 0.0));
    }
    if (!(opacity >= CULL_OPACITY)) {
        return;
    }
    let mean = frame.focal * slope + frame.center;
    let half_extent = sqrt(reach(opacity) * wide.xz);
    let low = 0.5 - frame.origin;
    let high = vec2f(frame.size) - 0.5 - frame.origin;
    if (!(all(mean + half_extent >= low) && all(mean - half_extent <= high))) {
        return;
    }
    let color = color_of(offset);
    if (!(all(abs(color) <= vec3f(LARGEST)))) {
        return;
    }
    let conic = vec3f(wide.z, -wide.y, wide.x) / determinant;
    shapes[index] = vec4f(mean, conic.xy);
    weights[index] = vec4f(conic.z, opacity, at.z, wide.z);
    colors[index] = vec4f(color, wide.x);
    keys[index] = bitcast<u32>(at.z);
}
