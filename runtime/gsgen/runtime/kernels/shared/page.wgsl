// The uniform that all Gaussians of a page share, and functions that read their rows.
//
// `page_uniform` of project.py writes the uniform. Rows are float32, or PACKED by compact_rows.py.

struct Page {
    linear: mat3x3f,      // local → camera, without the translation
    local_to_sh: mat3x3f, // local offset from the eye → direction that the harmonics were fitted for
    eye: vec3f,           // the camera centre in local space, rounded …
    opacity_scale: f32,
    eye_rest: vec3f,      // … and what the rounding left
    base: u32,            // index of the page's first Gaussian in the frame
    clip_low: vec3f,      // local box outside of which centres are not drawn
    count: u32,           // live Gaussians of the page
    clip_high: vec3f,
    degree: u32,          // of the harmonics; RGB where it is NO_HARMONICS
    mip: u32,
    capacity: u32,        // Gaussians that there is room for
    forward: vec3f,       // local: where an orthographic camera looks; zero for a pinhole
    // Of sets that are blended by weighted sums:
    per_cell: u32,        // Gaussians of a cell
    first_row: u32,       // of the page, in its set
    first_gaussian: u32,  // index in the frame of the set's first Gaussian
    inverse_range: f32,   // 1 / the depth where weights end; 0 where they do not
    inverse_divisor: f32, // 1 / what opacity is divided by
    behind: f32,          // weight of the background
    // For exact depths:
    linear_rest: mat3x3f, // what rounding `linear` left
    eye_at: vec3f,        // where the rounded `eye` is in camera space …
    zero: u32,            // 0, which compilers cannot know
    eye_at_rest: vec3f,   // … and what rounding that left
}

@group(1) @binding(0) var<uniform> page: Page;
@group(1) @binding(1) var<storage, read> rows: array<vec2u>;

struct Center {
    position: vec3f,
    opacity: f32,
}

// True for an orthographic camera.
fn is_flat() -> bool {
    return any(page.forward != vec3f(0.0));
}

// Two columns are read at once: for drivers on CPUs every read costs the same, however short.
fn columns(index: u32, pair: u32) -> vec2f {
    return bitcast<vec2f>(rows[index * select(5u, 4u, PACKED) + pair]);
}

fn read_center(index: u32) -> Center {
    let xy = columns(index, 0u);
    let z_opacity = columns(index, 1u);
    return Center(vec3f(xy, z_opacity.x), z_opacity.y);
}

// L Lᵀ, of the lower triangle of L.
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
