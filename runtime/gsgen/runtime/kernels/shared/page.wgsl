// The uniform that all Gaussians of a page share, and functions that read the page's rows.
//
// `page_uniforms` of project.py writes the uniform. Rows are float32, or PACKED by compact_rows.py.

struct Page {
    linear: mat3x3f,      // local → camera, without the translation
    local_to_sh: mat3x3f, // local offset from the eye → direction of the spherical harmonics
    eye: vec3f,           // the camera centre in local space, rounded …
    opacity_scale: f32,
    eye_rest: vec3f,      // … and the rounding error
    base: u32,            // index of the page's first Gaussian in the frame
    clip_low: vec3f,      // local box outside of which centres are not drawn
    count: u32,           // live Gaussians of the page
    clip_high: vec3f,
    degree: u32,          // SH degree; NO_HARMONICS for RGB
    mip: u32,             // 1: antialiasing of Mip-Splatting
    capacity: u32,        // rows of the page, live or not
    forward: vec3f,       // viewing direction of an orthographic camera, local; else zero
    // Only for sets that are blended by weighted sums:
    per_cell: u32,        // Gaussians of a cell
    first_row: u32,       // index in the set of the page's first Gaussian
    first_gaussian: u32,  // index in the frame of the set's first Gaussian
    inverse_range: f32,   // 1 / the depth at which weights reach 0; 0 without such a depth
    inverse_divisor: f32, // 1 / the divisor of opacities
    behind: f32,          // weight of the background
    // In slabs:
    per_slot: u32,        // fewest Gaussians of any cell of the frame
    first_cell: u32,      // index in the set of the first bound cell
    live_cells: u32,      // live cells of the set
    // For exact depths:
    linear_rest: mat3x3f, // the rounding error of `linear`
    eye_at: vec3f,        // the rounded `eye` in camera space …
    zero: u32,            // 0, which compilers cannot know
    eye_at_rest: vec3f,   // … and its rounding error
    // Of a pair of eyes, of which `eye` is the left one:
    eye_distance: f32,    // to the right eye, in camera space
    to_right_eye: vec3f,  // in local space
}

@group(1) @binding(0) var<uniform> page: Page;
@group(1) @binding(1) var<storage, read> rows: array<vec2u>;

// The camera centre in the space of a row: every row of a page has the page's, except in a pool.
struct Eye {
    at: vec3f,           // rounded …
    rest: vec3f,         // … and the rounding error
    camera: vec3f,       // the rounded centre in camera space …
    camera_rest: vec3f,  // … and its rounding error
}

// Set at the start of every invocation, before a function reads it.
var<private> eye: Eye;

fn page_eye() -> Eye {
    return Eye(page.eye, page.eye_rest, page.eye_at, page.eye_at_rest);
}

struct Center {
    position: vec3f,
    opacity: f32,
}

// True for an orthographic camera.
fn is_flat() -> bool {
    return any(page.forward != vec3f(0.0));
}

// Two columns are read at once: on software drivers every read costs the same, however short.
fn columns(index: u32, pair: u32) -> vec2f {
    return bitcast<vec2f>(rows[index * select(5u, 4u, PACKED) + pair]);
}

fn read_center(index: u32) -> Center {
    let xy = columns(index, 0u);
    let z_opacity = columns(index, 1u);
    return Center(vec3f(xy, z_opacity.x), z_opacity.y);
}

// Return L Lᵀ from the packed lower triangle of L.
fn read_packed_covariance(index: u32) -> mat3x3f {
    let a = rows[index * 4u + 2u];
    let b = rows[index * 4u + 3u];
    let scale = bitcast<f32>(b.y);
    let x = scale * unpack2x16snorm(a.x);             // xx yx
    let y = scale * unpack2x16snorm(a.y);             // zx yy
    let z = scale * unpack2x16snorm(b.x);             // zy zz
    let xy = x.x * x.y;
    let xz = x.x * y.x;
    let yz = x.y * y.x + y.y * z.x;
    return mat3x3f(
        vec3f(x.x * x.x, xy, xz),
        vec3f(xy, x.y * x.y + y.y * y.y, yz),
        vec3f(xz, yz, y.x * y.x + dot(z, z)),
    );
}

fn read_covariance(index: u32) -> mat3x3f {
    if (PACKED) {
        return read_packed_covariance(index);
    }
    let a = columns(index, 2u);  // xx xy
    let b = columns(index, 3u);  // xz yy
    let c = columns(index, 4u);  // yz zz
    return mat3x3f(vec3f(a, b.x), vec3f(a.y, b.y, c.x), vec3f(b.x, c));
}
