// The uniform that all Gaussians of a frame share; `frame_uniform` of project.py writes it.

struct Frame {
    focal: vec2f,        // pixels
    center: vec2f,       // principal point minus `origin`, pixels
    slope_low: vec2f,    // x/z and y/z beyond which the Jacobian, or a lens's derivative, stays constant
    slope_high: vec2f,
    origin: vec2f,       // whole pixels; image coordinates are relative to it, for precision
    near: f32,
    period: f32,         // of a panorama: pixels of a full turn
    size: vec2u,         // pixels
    resumes: u32,        // 1: the image holds the state of pixels after nearer splats; 2: within a cell
    continues: u32,      // 1: it keeps their state for farther splats
    background: vec4f,   // red, green, blue; alpha stays that of the splats
    extra_dilation: f32, // pixels², beyond DILATION; negative for pictures that are enlarged
    rank: u32,           // what the keys of slabs are: 0 depths, 1 remainders of one depth, 2 rows or cells, 3 rows of one cell
    tied_key: u32,       // the depth whose splats are ranked, or the first Gaussian of the cell …
    tied_low: u32,       // … and, for rows or cells, its remainder, or the Gaussians of the cell in the slab
    // Of lenses, for lens.wgsl:
    radial: vec4f,       // k1 to k4
    divisor: vec3f,      // d1 to d3
    ray_limit: f32,      // how far from the axis rays are drawn: a slope, of a fisheye an angle
    tangential: vec2f,   // p1 and p2
    prism: vec2f,        // s1 and s2
}

// A panorama draws a splat up to three times: a full turn to the left, where it is, and to the right.
const FIRST_COPY = 1u - u32(PANORAMA);
const COPIES = 1u + 2u * u32(PANORAMA);

@group(0) @binding(0) var<uniform> frame: Frame;

// Return how many tiles the image has, across and down.
fn image_tiles() -> vec2u {
    return (frame.size + TILE - 1u) / TILE;
}

// The shorter horizontal distance: in a panorama it may cross the image's left and right edges.
fn nearest(across: f32) -> f32 {
    if (PANORAMA) {
        return across - frame.period * round(across / frame.period);
    }
    return across;
}
