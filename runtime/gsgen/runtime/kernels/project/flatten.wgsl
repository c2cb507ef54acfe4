// Where a Gaussian or a cell is in the image, and what is left of its covariance there.
// Needs frame.wgsl, page.wgsl and panorama.wgsl.

struct Flat {
    mean: vec2f,         // pixels, relative to the frame's origin
    plain: vec3f,        // 2D covariance xx xy yy, pixels²
    wide: vec3f,         // with the dilation
    unit: f32,           // a power of two, pixels², in whose units nothing overflows …
    scaled: vec3f,       // … `wide`, in which it is not rounded either …
    determinant: f32,    // … and its determinant
    sound: bool,         // whether it is an ellipse of a finite size
}

const LARGEST = 3.4e38;
const LARGEST_VARIANCE = 1e30;  // pixels²; the reciprocal still has all its digits

// Along the camera's +z; in a panorama from its centre. at: in camera space.
fn depth_of(at: vec3f) -> f32 {
    if (PANORAMA) {
        return distance_of(at);
    }
    return at.z;
}

// at: the centre in camera space. depth: of it, which is positive.
fn flatten(at: vec3f, depth: f32, sigma: mat3x3f) -> Flat {
    let inverse = select(1.0 / at.z, 1.0, is_flat());
    let slope = at.xy * inverse;
    let bent = select(clamp(slope, frame.slope_low, frame.slope_high), vec2f(0.0), is_flat());
    // Rows of the Jacobian times the rotation: how the pixel moves with the local position.
    let turned = transpose(page.linear);
    var jx = frame.focal.x * inverse * (turned[0] - bent.x * turned[2]);
    var jy = frame.focal.y * inverse * (turned[1] - bent.y * turned[2]);
    var made: Flat;
    made.mean = frame.focal * slope + frame.center;
    if (PANORAMA) {
        let sight = sight_around(at, depth);
        jx = frame.focal.x * (turned * sight.jx);
        jy = frame.focal.y * (turned * sight.jy);
        made.mean = frame.focal * sight.angles + frame.center;
        let middle = 0.5 * f32(frame.size.x) - frame.origin.x;
        made.mean.x = middle + nearest(made.mean.x - middle);
    }
    let sx = sigma * jx;
    let sy = sigma * jy;
    made.plain = vec3f(dot(jx, sx), dot(jx, sy), dot(jy, sy));
    made.wide = vec3f(made.plain.x + DILATION, made.plain.y, made.plain.z + DILATION);
    let most = max(made.wide.x, made.wide.z);
    made.unit = bitcast<f32>(bitcast<u32>(most) & 0x7f800000u);
    made.scaled = made.wide / made.unit;
    made.determinant = made.scaled.x * made.scaled.z - made.scaled.y * made.scaled.y;
    made.sound = made.wide.x > 0.0 && made.wide.z > 0.0 && most <= LARGEST_VARIANCE
        && made.determinant > 0.0;
    return made;
}
