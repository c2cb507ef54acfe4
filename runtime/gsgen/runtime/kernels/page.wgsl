// What all Gaussians of a page share, and how their rows are read. Written by project.py's
// `page_uniform`. Needs `rows: array<vec2u>`, which are float32.

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
    behind: f32,          // weight of what is behind
}

struct Center {
    position: vec3f,
    opacity: f32,
}

fn is_flat() -> bool {
    return any(page.forward != vec3f(0.0));
}

// Two columns are read at once: drivers on CPUs pay by the read, however short.
fn columns(index: u32, pair: u32) -> vec2f {
    return bitcast<vec2f>(rows[index * 5u + pair]);
}

fn read_center(index: u32) -> Center {
    let xy = columns(index, 0u);
    let z_opacity = columns(index, 1u);
    return Center(vec3f(xy, z_opacity.x), z_opacity.y);
}

fn read_covariance(index: u32) -> mat3x3f {
    let a = columns(index, 2u);  // xx xy
    let b = columns(index, 3u);  // xz yy
    let c = columns(index, 4u);  // yz zz
    return mat3x3f(vec3f(a, b.x), vec3f(a.y, b.y, c.x), vec3f(b.x, c));
}
