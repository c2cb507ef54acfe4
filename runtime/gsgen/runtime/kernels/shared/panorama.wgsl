// Panorama: longitude and latitude of a position, and their derivatives.
//
// With r² = x² + y² + z² and ρ² = x² + z², longitude is atan2(x, z) and latitude, downwards, is
// asin(y / r) = atan2(y, ρ), which is precise near the poles, too. Their derivatives are
//
//     longitude: (z, 0, −x) / ρ²        latitude: (−x y / ρ, ρ, −y z / ρ) / r²
//
// The first is unbounded at the poles: there ρ is clamped to at least r · POLE.

struct Sight {
    angles: vec2f,  // longitude and latitude, radians
    jx: vec3f,      // derivative of the longitude by the position in camera space
    jy: vec3f,      // derivative of the latitude
}

// Return the angle of (x, y) from the x axis, to 2e-7: a driver's atan2 may be off by 4096 units in
// the last place. The minimax polynomial approximates atan(t) / t on 0 ≤ t² ≤ 1.
fn turn_of(y: f32, x: f32) -> f32 {
    let long = max(abs(x), abs(y));
    let t = min(abs(x), abs(y)) / max(long, SMALLEST);
    let s = t * t;
    var angle = 0.002456670394167304 * s - 0.014401118271052837;
    angle = angle * s + 0.03978078439831734;
    angle = angle * s - 0.07234814018011093;
    angle = angle * s + 0.10498920828104019;
    angle = angle * s - 0.1416122019290924;
    angle = angle * s + 0.19985905289649963;
    angle = angle * s - 0.33332598209381104;
    angle = (angle * s + 1.0) * t;
    angle = select(angle, 1.5707963267948966 - angle, abs(y) > abs(x));
    angle = select(angle, 3.141592653589793 - angle, x < 0.0);
    return select(angle, -angle, y < 0.0);
}

const SMALLEST = 1e-37;

// Return the length of a nonzero vector without overflow of squares.
fn distance_of(at: vec3f) -> f32 {
    let most = max(max(abs(at.x), abs(at.y)), max(abs(at.z), SMALLEST));
    return most * length(at / most);
}

// Return longitude and latitude with derivatives. distance: r, which is positive.
fn sight_around(at: vec3f, distance: f32) -> Sight {
    let unit = at / distance;
    let level = length(unit.xz);
    let heading = select(vec2f(0.0, 1.0), unit.xz / level, level > 0.0);
    var sight: Sight;
    sight.angles = vec2f(turn_of(heading.x, heading.y), turn_of(unit.y, level));
    sight.jx = vec3f(heading.y, 0.0, -heading.x) / (max(level, POLE) * distance);
    sight.jy = vec3f(-heading.x * unit.y, level, -heading.y * unit.y) / distance;
    return sight;
}
