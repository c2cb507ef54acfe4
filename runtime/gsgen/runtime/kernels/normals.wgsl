// Normals: the direction in which each drawn Gaussian of one page is thinnest, towards the camera.
//
// One invocation per Gaussian. The eigenvalues of the covariance are those of Smith 1961, the
// eigenvector is the longest of the cross products of two rows of Σ − λI. A ball has no thinnest
// direction; it looks at the camera.

@group(0) @binding(0) var<storage, read> keys: array<u32>;
@group(0) @binding(1) var<storage, read_write> normals: array<vec4f>;  // in camera space

@group(1) @binding(0) var<uniform> page: Page;
@group(1) @binding(1) var<storage, read> rows: array<vec2u>;

//!include page

const ROUND = 1e-5;  // how far from one the ratio of eigenvalues of a ball may be

fn longest(a: vec3f, b: vec3f) -> vec3f {
    return select(a, b, dot(b, b) > dot(a, a));
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
    let angle = acos(clamp(determinant(unit) / 2.0, -1.0, 1.0)) / 3.0;
    let least = mean + 2.0 * spread * cos(angle + 2.0943951023931953);
    let rest = s - least * one;
    let found = longest(cross(rest[0], rest[1]), longest(cross(rest[0], rest[2]), cross(rest[1], rest[2])));
    let size = length(found);
    if (!(size > ROUND * spread * spread)) {
        return vec3f(0.0);
    }
    return found / size;
}

@compute @workgroup_size(THREADS)
fn find_normals(@builtin(global_invocation_id) invocation: vec3u) {
    let own = invocation.x;
    if (own >= page.count || keys[page.base + own] == ABSENT) {
        return;
    }
    let offset = (read_center(own).position - page.eye) - page.eye_rest;
    let at = page.linear * select(offset, page.forward, is_flat());
    let found = thinnest(page.linear * read_covariance(own) * transpose(page.linear));
    let towards = select(found, -found, dot(found, at) > 0.0);
    let normal = select(-normalize(at), towards, dot(found, found) > 0.5);
    normals[page.base + own] = vec4f(normal, 0.0);
}
