// The normal of one Gaussian: its shortest axis, turned towards the camera.
//
// The eigenvalues of the covariance are those of Smith 1961; the
// eigenvector of an eigenvalue far from the others is the longest cross product of two rows of
// Σ − λI. For a needle that is its long axis; the shorter of its two short axes follows from its
// 2×2 section, which contains no large numbers. Balls and round needles have no shortest axis:
// their normals point at the camera.

//!include page

@group(0) @binding(0) var<storage, read> keys: array<u32>;
@group(0) @binding(1) var<storage, read_write> normals: array<vec4f>;  // in camera space

const ROUND = 1e-5;  // tolerance of the ratio of equal eigenvalues

fn longest(a: vec3f, b: vec3f) -> vec3f {
    return select(a, b, dot(b, b) > dot(a, a));
}

// Return an eigenvector, not normalised, of a simple eigenvalue.
fn along(s: mat3x3f, value: f32) -> vec3f {
    let one = mat3x3f(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), vec3f(0.0, 0.0, 1.0));
    let rest = s - value * one;
    return longest(cross(rest[0], rest[1]), longest(cross(rest[0], rest[2]), cross(rest[1], rest[2])));
}

// Return the shortest axis of a needle from the 2×2 section across its long axis.
fn across(s: mat3x3f, axis: vec3f, most: f32) -> vec3f {
    let side = normalize(select(vec3f(0.0, axis.z, -axis.y), vec3f(-axis.z, 0.0, axis.x), abs(axis.x) > abs(axis.y)));
    let other = cross(axis, side);
    let half = (dot(side, s * side) - dot(other, s * other)) / 2.0;
    let mixed = dot(side, s * other);
    let radius = length(vec2f(half, mixed));
    if (!(2.0 * radius > ROUND * most)) {
        return vec3f(0.0);
    }
    let turned = select(vec2f(radius - half, -mixed), vec2f(-mixed, radius + half), half >= 0.0);
    return normalize(turned.x * side + turned.y * other);
}

fn thinnest(covariance: mat3x3f) -> vec3f {
    let scale = max(max(covariance[0].x, covariance[1].y), covariance[2].z);
    let s = covariance * (1.0 / scale);
    let mean = (s[0].x + s[1].y + s[2].z) / 3.0;
    let off = s[1].x * s[1].x + s[2].x * s[2].x + s[2].y * s[2].y;
    let diagonal = vec3f(s[0].x, s[1].y, s[2].z) - mean;
    let spread = sqrt((dot(diagonal, diagonal) + 2.0 * off) / 6.0);
    if (!(spread > ROUND)) {
        return vec3f(0.0);
    }
    let one = mat3x3f(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), vec3f(0.0, 0.0, 1.0));
    let unit = (s - mean * one) * (1.0 / spread);
    let bent = determinant(unit) / 2.0;
    let angle = acos(clamp(bent, -1.0, 1.0)) / 3.0;
    if (bent > 0.0) {  // the longest axis stands out, and the others may be nearly equal
        let most = mean + 2.0 * spread * cos(angle);
        return across(s, normalize(along(s, most)), most);
    }
    let least = mean + 2.0 * spread * cos(angle + 2.0943951023931953);
    return normalize(along(s, least));
}

// Write the normal of row `own`, whose `eye` is set; nothing for a row that is not drawn.
fn write_normal(own: u32) {
    // If PLACED, the keys are the indices of the rows' splats, or ABSENT.
    let key = keys[select(page.base + own, own, PLACED)];
    if (own >= page.count || key == ABSENT) {
        return;
    }
    let offset = (read_center(own).position - eye.at) - eye.rest;
    let at = page.linear * select(offset, page.forward, is_flat());
    let axis = thinnest(page.linear * read_covariance(own) * transpose(page.linear));
    let towards = select(axis, -axis, dot(axis, at) > 0.0);
    let normal = select(-normalize(at), towards, dot(axis, axis) > 0.5);
    normals[select(page.base + own, key, PLACED)] = vec4f(normal, 0.0);
}
