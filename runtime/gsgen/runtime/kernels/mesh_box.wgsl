// Where a triangle can be in a panorama: a box of pixels that has all of it. It may be too large:
// each pixel's ray decides.
//
// Along an edge longitude goes one way, so it is extreme at corners; where they span half a turn,
// the triangle is above or below the camera, and has the pole. Latitude is extreme at corners, at
// one point of an edge at most, or at the pole. Needs panorama.wgsl and `place`.

const HALF_TURN = 3.1415927;
const ROUNDING = 2e-6;  // of angles, and of positions by the triangle's size

struct Latitudes {
    low: f32,
    high: f32,
}

// Latitude of a point, a little less and a little more. extent: of the triangle.
fn latitudes_of(at: vec3f, extent: f32) -> Latitudes {
    let angle = turn_of(at.y, length(at.xz));
    let slack = ROUNDING * (1.0 + extent / max(length(at), SMALLEST));
    return Latitudes(angle - slack, angle + slack);
}

fn joined(a: Latitudes, b: Latitudes) -> Latitudes {
    return Latitudes(min(a.low, b.low), max(a.high, b.high));
}

// Of the corner `a`, and of the point of the edge to `b` where the latitude turns round: there
// y / ρ has no derivative along the edge.
fn latitudes_along(a: vec3f, b: vec3f, extent: f32) -> Latitudes {
    let step = b - a;
    let level = dot(a.xz, step.xz);
    let top = step.y * dot(a.xz, a.xz) - a.y * level;
    let bottom = a.y * dot(step.xz, step.xz) - step.y * level;
    let share = select(0.0, clamp(top / bottom, 0.0, 1.0), abs(bottom) > 0.0);
    return joined(latitudes_of(a, extent), latitudes_of(a + share * step, extent));
}

// The box as left, upper, right and lower edge, in pixels of the image.
fn box_around(corner_a: vec3f, corner_b: vec3f, corner_c: vec3f) -> vec4f {
    let most = max(max(abs(corner_a), abs(corner_b)), abs(corner_c));
    let unit = max(max(most.x, most.y), max(most.z, SMALLEST));
    let a = corner_a / unit;
    let b = corner_b / unit;
    let c = corner_c / unit;
    let extent = max(length(a), max(length(b), length(c)));

    let first = turn_of(a.x, a.z);
    var others = vec2f(turn_of(b.x, b.z), turn_of(c.x, c.z)) - first;
    others -= 2.0 * HALF_TURN * round(others / (2.0 * HALF_TURN));
    let level = min(length(a.xz), min(length(b.xz), length(c.xz)));
    let slack = ROUNDING * (1.0 + extent / max(level, SMALLEST));
    let low = min(min(others.x, others.y), 0.0) - slack;
    let high = max(max(others.x, others.y), 0.0) + slack;
    let is_around = !(high - low < 0.99 * HALF_TURN);

    var tall = latitudes_along(a, b, extent);
    tall = joined(tall, latitudes_along(b, c, extent));
    tall = joined(tall, latitudes_along(c, a, extent));
    if (is_around && max(a.y, max(b.y, c.y)) >= 0.0) {
        tall.high = HALF_TURN;
    }
    if (is_around && min(a.y, min(b.y, c.y)) <= 0.0) {
        tall.low = -HALF_TURN;
    }

    let margin = vec2f(1.0);
    var left_top = place.focal * vec2f(first + low, tall.low) + place.center - margin;
    var right_bottom = place.focal * vec2f(first + high, tall.high) + place.center + margin;
    // Of the places a whole turn apart, the one farthest to the right that is in the image.
    let turns = place.period * floor((left_top.x - place.size.x) / place.period + 1.0);
    left_top.x -= turns;
    right_bottom.x -= turns;
    if (is_around || right_bottom.x > place.period) {
        left_top.x = 0.0;  // there is another one at the left edge
        right_bottom.x = place.size.x;
    }
    return vec4f(
        clamp(left_top, vec2f(0.0), place.size),
        clamp(right_bottom, vec2f(0.0), place.size),
    );
}
