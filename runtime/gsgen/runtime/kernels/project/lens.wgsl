// Lens: where a distorted pinhole or a fisheye sees a position, and the derivative.
//
// The point p of the image plane is (x, y)/z, of a fisheye θ (x, y)/ρ with ρ² = x² + y² and the angle
// θ = atan2(ρ, z) from the axis. The lens moves p = (u, v), with s = u² + v², to
//
//     p (1 + k1 s + k2 s² + k3 s³ + k4 s⁴) / (1 + d1 s + d2 s² + d3 s³)
//     + (2 p1 u v + p2 (s + 2 u²) + s1 s,  2 p2 u v + p1 (s + 2 v²) + s2 s)

//!include frame
//!include panorama

struct Moved {
    point: vec2f,
    x: vec2f,  // derivative of point.x by p
    y: vec2f,  // derivative of point.y
}

fn moved_by_lens(p: vec2f) -> Moved {
    let s = dot(p, p);
    let k = frame.radial;
    let d = frame.divisor;
    let bottom = 1.0 + s * (d.x + s * (d.y + s * d.z));
    let factor = (1.0 + s * (k.x + s * (k.y + s * (k.z + s * k.w)))) / bottom;
    let top_slope = k.x + s * (2.0 * k.y + s * (3.0 * k.z + s * (4.0 * k.w)));
    let bottom_slope = d.x + s * (2.0 * d.y + s * (3.0 * d.z));
    let slope = 2.0 * (top_slope - factor * bottom_slope) / bottom;
    let t = frame.tangential;
    let prism = frame.prism;
    let uv = p.x * p.y;
    let across = uv * slope + 2.0 * dot(t, p);
    var moved: Moved;
    moved.point = factor * p + 2.0 * uv * t + t.yx * (s + 2.0 * p * p) + prism * s;
    moved.x = vec2f(factor + p.x * p.x * slope + 2.0 * t.x * p.y + 6.0 * t.y * p.x, across) + 2.0 * prism.x * p;
    moved.y = vec2f(across, factor + p.y * p.y * slope + 2.0 * t.y * p.x + 6.0 * t.x * p.y) + 2.0 * prism.y * p;
    return moved;
}

// Return the plane point of a fisheye, with its derivatives by the position. distance: of `at` from
// the camera, positive.
fn fisheye_sight(at: vec3f, distance: f32) -> Sight {
    let unit = at / distance;
    let level = length(unit.xy);
    let angle = turn_of(level, unit.z);
    let heading = select(vec2f(1.0, 0.0), unit.xy / level, level > 0.0);
    let aside = vec2f(-heading.y, heading.x);
    let outward = vec3f(unit.z * heading, -level) / distance;
    let around = vec3f(select(1.0, angle / level, level > 0.0) * aside, 0.0) / distance;
    var sight: Sight;
    sight.angles = angle * heading;
    sight.jx = heading.x * outward + aside.x * around;
    sight.jy = heading.y * outward + aside.y * around;
    return sight;
}
