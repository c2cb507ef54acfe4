// The cover of a triangle: the area whose pixels the rasteriser visits. It is the triangle, slightly
// enlarged, or one around its bounding box where the projection is not that simple. A cover may be
// too large, because each pixel's ray decides.

//!include mesh_place
//!include panorama

struct Box {
    low: vec2f,   // pixels: the left and the upper edge
    high: vec2f,  // the right and the lower edge
}

const MARGIN = 0.125;    // pixels: rasterisers may round corners to sixteenths
const ROUNDING = 2e-6;   // error of angles, and of positions relative to the triangle's size
const MOST_GROWTH = 4.0;
const FARTHEST = 3e4;    // pixels, up to which the margin is not lost to rounding
const FAR_AWAY = 1e30;
const HALF_TURN = 3.1415927;

fn joined(a: Box, b: Box) -> Box {
    return Box(min(a.low, b.low), max(a.high, b.high));
}

// Return the pixels per world unit at a point in front of the camera.
fn pixels_per_unit(at: vec3f) -> vec2f {
    return place.focal * select(1.0 / at.z, 1.0, place.is_flat == 1u);
}

fn pixel_of(at: vec3f) -> vec2f {
    return pixels_per_unit(at) * at.xy + place.center;
}

// Return the rounding error of a point in pixels. extent: the size of the triangle.
fn slack_at(at: vec3f, extent: f32) -> vec2f {
    return pixels_per_unit(at) * (ROUNDING * extent);
}

fn box_at(at: vec3f, extent: f32) -> Box {
    return Box(pixel_of(at) - slack_at(at, extent), pixel_of(at) + slack_at(at, extent));
}

// Return the bounding box of the part of an edge beyond the near plane.
fn box_along(a: vec3f, b: vec3f, extent: f32) -> Box {
    if (!(max(a.z, b.z) > place.near)) {
        return Box(vec2f(FAR_AWAY), vec2f(-FAR_AWAY));
    }
    let cut = mix(a, b, clamp((place.near - a.z) / (b.z - a.z), 0.0, 1.0));
    let start = select(vec3f(cut.xy, place.near), a, a.z > place.near);
    let end = select(vec3f(cut.xy, place.near), b, b.z > place.near);
    return joined(box_at(start, extent), box_at(end, extent));
}

fn box_ahead(a: vec3f, b: vec3f, c: vec3f, extent: f32) -> Box {
    return joined(box_along(a, b, extent), joined(box_along(b, c, extent), box_along(c, a, extent)));
}

// Return the latitude of a point, minus and plus the rounding error.
fn latitudes_at(at: vec3f, extent: f32) -> vec2f {
    let slack = ROUNDING * (1.0 + extent / max(length(at), SMALLEST));
    return turn_of(at.y, length(at.xz)) + vec2f(-slack, slack);
}

// Return the latitudes of the point of an edge where the latitude is extreme, that is, where the
// derivative of y / ρ along the edge is zero; otherwise those of a corner. The point is computed
// from the nearer corner, for precision.
fn latitudes_along(one: vec3f, other: vec3f, extent: f32) -> vec2f {
    let is_nearer = dot(one, one) < dot(other, other);
    let near = select(other, one, is_nearer);
    let step = select(one, other, is_nearer) - near;
    let level = dot(near.xz, step.xz);
    let top = step.y * dot(near.xz, near.xz) - near.y * level;
    let bottom = near.y * dot(step.xz, step.xz) - step.y * level;
    let share = select(0.0, clamp(top / bottom, 0.0, 1.0), abs(bottom) > 0.0);
    return latitudes_at(near + share * step, extent);
}

// Return the bounding box in a panorama. Along an edge the longitude is monotonic, so it is extreme
// at corners. If the corners span half a turn, the triangle is above or below the camera and
// contains a pole.
fn box_around(corner_a: vec3f, corner_b: vec3f, corner_c: vec3f) -> Box {
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
    let left = min(min(others.x, others.y), 0.0) - slack;
    let right = max(max(others.x, others.y), 0.0) + slack;
    let is_around = !(right - left < 0.99 * HALF_TURN);

    let corners = array<vec2f, 3>(latitudes_at(a, extent), latitudes_at(b, extent), latitudes_at(c, extent));
    let ab = latitudes_along(a, b, extent);
    let bc = latitudes_along(b, c, extent);
    let ca = latitudes_along(c, a, extent);
    var upper = min(min(corners[0].x, min(corners[1].x, corners[2].x)), min(ab.x, min(bc.x, ca.x)));
    var lower = max(max(corners[0].y, max(corners[1].y, corners[2].y)), max(ab.y, max(bc.y, ca.y)));
    if (is_around && max(a.y, max(b.y, c.y)) >= 0.0) {
        lower = HALF_TURN;
    }
    if (is_around && min(a.y, min(b.y, c.y)) <= 0.0) {
        upper = -HALF_TURN;
    }

    var low = place.focal * vec2f(first + left, upper) + place.center;
    var high = place.focal * vec2f(first + right, lower) + place.center;
    // Of the positions a full turn apart, take the rightmost one in the image.
    let turns = place.period * floor((low.x - MARGIN - place.size.x) / place.period + 1.0);
    low.x -= turns;
    high.x -= turns;
    if (is_around || high.x + MARGIN > place.period) {
        low.x = 0.0;  // another part is at the left edge
        high.x = place.size.x;
    }
    return Box(low, high);
}

fn inside_image(box: Box) -> Box {
    let low = clamp(box.low - MARGIN, vec2f(0.0), place.size);
    return Box(low, clamp(box.high + MARGIN, low, place.size));
}

// Return a corner of the cover of a triangle, in pixels, except in panoramas.
fn cover_ahead(which: u32, a: vec3f, b: vec3f, c: vec3f) -> vec2f {
    let extent = max(distance_of(a), max(distance_of(b), distance_of(c)));
    let p = pixel_of(a);
    let q = pixel_of(b);
    let r = pixel_of(c);
    // Enlarged around its incentre, every side of a triangle moves by the same distance.
    let sides = vec3f(distance(q, r), distance(r, p), distance(p, q));
    let center = (sides.x * p + sides.y * q + sides.z * r) / (sides.x + sides.y + sides.z);
    let area = abs((q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x));
    let radius = area / (sides.x + sides.y + sides.z);
    let slack = max(slack_at(a, extent), max(slack_at(b, extent), slack_at(c, extent)));
    let growth = 1.0 + (MARGIN + max(slack.x, slack.y)) / radius;
    let is_ahead = min(a.z, min(b.z, c.z)) > place.near || place.is_flat == 1u;
    let is_small = all(max(abs(p), max(abs(q), abs(r))) < vec2f(FARTHEST));
    if (is_ahead && is_small && growth < MOST_GROWTH) {
        let own = select(select(r, q, which == 1u), p, which == 0u);
        return center + growth * (own - center);
    }
    let box = inside_image(box_ahead(a, b, c, extent));  // a triangle around it is twice as long
    return box.low + 2.0 * (box.high - box.low) * vec2f(vec2u(which & 1u, which >> 1u));
}

// Return a corner of the cover of a triangle: one of three, or in a panorama one of six of two
// triangles.
fn cover(which: u32, a: vec3f, b: vec3f, c: vec3f) -> vec2f {
    if (!PANORAMA) {
        return cover_ahead(which, a, b, c);
    }
    let box = inside_image(box_around(a, b, c));
    let corner = select(which, which - 2u, which > 2u);
    return select(box.low, box.high, vec2<bool>((corner & 1u) == 1u, corner >= 2u));
}
