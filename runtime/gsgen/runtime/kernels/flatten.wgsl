// Where a cell is in the image, and how large, worked out as project.wgsl does for Gaussians.
// Needs frame.wgsl, page.wgsl and panorama.wgsl.

struct Flat {
    depth: f32,    // along the camera's +z; in a panorama from its centre
    mean: vec2f,   // pixels, relative to the frame's origin
    wide: vec3f,   // 2D covariance xx xy yy with the dilation, in units of …
    unit: f32,     // … a power of two, pixels²
    sound: bool,   // whether it is drawn at all
}

const LARGEST = 3.4e38;
const LARGEST_VARIANCE = 1e30;  // pixels²; the reciprocal still has all its digits

// at: the centre in camera space.
fn flatten(at: vec3f, sigma: mat3x3f) -> Flat {
    var made: Flat;
    let inverse = select(1.0 / at.z, 1.0, is_flat());
    let slope = at.xy * inverse;
    let bent = select(clamp(slope, frame.slope_low, frame.slope_high), vec2f(0.0), is_flat());
    // Rows of the Jacobian times the rotation: how the pixel moves with the local position.
    let turned = transpose(page.linear);
    made.depth = at.z;
    made.mean = frame.focal * slope + frame.center;
    var jx = frame.focal.x * inverse * (turned[0] - bent.x * turned[2]);
    var jy = frame.focal.y * inverse * (turned[1] - bent.y * turned[2]);
    if (PANORAMA) {
        made.depth = distance_of(at);
        let sight = sight_around(at, made.depth);
        jx = frame.focal.x * (turned * sight.jx);
        jy = frame.focal.y * (turned * sight.jy);
        made.mean = frame.focal * sight.angles + frame.center;
        let middle = 0.5 * f32(frame.size.x) - frame.origin.x;
        made.mean.x = middle + nearest(made.mean.x - middle);
    }
    let sx = sigma * jx;
    let sy = sigma * jy;
    let wide = vec3f(dot(jx, sx) + DILATION, dot(jx, sy), dot(jy, sy) + DILATION);
    // In units of a power of two, so that nothing overflows and nothing is rounded.
    let most = max(wide.x, wide.z);
    made.unit = bitcast<f32>(bitcast<u32>(most) & 0x7f800000u);
    made.wide = wide / made.unit;
    made.sound = made.depth > frame.near && made.depth <= LARGEST
        && wide.x > 0.0 && wide.z > 0.0 && most <= LARGEST_VARIANCE
        && made.wide.x * made.wide.z - made.wide.y * made.wide.y > 0.0;
    return made;
}
