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
}

struct Row {
    position: vec3f,
    opacity: f32,
    covariance: mat3x3f,
}

// Two columns, or four channels, are read at once: drivers on CPUs pay by the read, however short.
fn read_row(index: u32) -> Row {
    var pairs: array<vec2f, 5>;
    for (var i = 0u; i < 5u; i++) {
        pairs[i] = bitcast<vec2f>(rows[index * 5u + i]);
    }
    return Row(
        vec3f(pairs[0], pairs[1].x),
        pairs[1].y,
        mat3x3f(
            vec3f(pairs[2], pairs[3].x),
            vec3f(pairs[2].y, pairs[3].y, pairs[4].x),
            vec3f(pairs[3].x, pairs[4]),
        ),
    );
}
