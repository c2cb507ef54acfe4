// Project the centre and the covariance of a Gaussian or a cell into the image.

//!include frame
//!include page
//!include panorama
//!include lens

struct Flat {
    mean: vec2f,         // pixels, relative to the frame's origin
    bare: vec3f,         // 2D covariance xx xy yy, pixels²
    dilated: vec3f,      // the same with the dilation
    unit: f32,           // a power of two, pixels², that prevents overflow;
    inverse_unit: f32,   // its reciprocal
    scaled: vec3f,       // `dilated` divided by `unit`, without rounding
    determinant: f32,    // of `scaled`
    is_valid: bool,      // true for an ellipse of finite size
}

const LARGEST = 3.4e38;
const LARGEST_VARIANCE = 1e30;  // pixels²; its reciprocal is still a normal float

// Return the depth of a point in camera space: along +z, in a fisheye and a panorama from the camera.
fn depth_of(at: vec3f) -> f32 {
    if (PANORAMA || FISHEYE) {
        return distance_of(at);
    }
    return at.z;
}

// at: the centre in camera space; depth: its depth, which is positive.
fn flatten(at: vec3f, depth: f32, sigma: mat3x3f) -> Flat {
    let inverse = select(1.0 / at.z, 1.0, is_flat());
    let slope = at.xy * inverse;
    let bent = select(clamp(slope, frame.slope_low, frame.slope_high), vec2f(0.0), is_flat());
    // Rows of the Jacobian times the rotation: derivatives of the pixel by the local position.
    let turned = transpose(page.linear);
    var jx = frame.focal.x * inverse * (turned[0] - bent.x * turned[2]);
    var jy = frame.focal.y * inverse * (turned[1] - bent.y * turned[2]);
    var flat: Flat;
    flat.mean = frame.focal * slope + frame.center;
    if (PANORAMA) {
        let sight = sight_around(at, depth);
        jx = frame.focal.x * (turned * sight.jx);
        jy = frame.focal.y * (turned * sight.jy);
        flat.mean = frame.focal * sight.angles + frame.center;
        let middle = 0.5 * f32(frame.size.x) - frame.origin.x;
        flat.mean.x = middle + nearest(flat.mean.x - middle);
    }
    var is_in_range = true;
    if (DISTORTED || FISHEYE) {
        var point = slope;
        var px = inverse * (turned[0] - bent.x * turned[2]);
        var py = inverse * (turned[1] - bent.y * turned[2]);
        if (FISHEYE) {
            let sight = fisheye_sight(at, depth);
            point = sight.angles;
            px = turned * sight.jx;
            py = turned * sight.jy;
        }
        // Beside the image the lens goes on linearly: its polynomials would grow without limit.
        let inside = clamp(point, frame.slope_low, frame.slope_high);
        let moved = moved_by_lens(inside);
        let beyond = point - inside;
        let seen = moved.point + vec2f(dot(moved.x, beyond), dot(moved.y, beyond));
        jx = frame.focal.x * (moved.x.x * px + moved.x.y * py);
        jy = frame.focal.y * (moved.y.x * px + moved.y.y * py);
        flat.mean = frame.focal * seen + frame.center;
        is_in_range = dot(point, point) < frame.ray_limit * frame.ray_limit;
    }
    let sx = sigma * jx;
    let sy = sigma * jy;
    flat.bare = vec3f(dot(jx, sx), dot(jx, sy), dot(jy, sy));
    let dilation = DILATION + frame.extra_dilation;
    flat.dilated = vec3f(flat.bare.x + dilation, flat.bare.y, flat.bare.z + dilation);
    let most = max(flat.dilated.x, flat.dilated.z);
    let exponent = bitcast<u32>(most) & 0x7f800000u;
    flat.unit = bitcast<f32>(exponent);
    flat.inverse_unit = bitcast<f32>((254u << 23u) - exponent);
    flat.scaled = flat.dilated * flat.inverse_unit;
    flat.determinant = flat.scaled.x * flat.scaled.z - flat.scaled.y * flat.scaled.y;
    flat.is_valid = flat.dilated.x > 0.0 && flat.dilated.z > 0.0 && most <= LARGEST_VARIANCE
        && flat.unit > 0.0 && flat.determinant > 0.0 && is_in_range;
    return flat;
}
