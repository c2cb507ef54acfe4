// What all Gaussians of a frame share. Written by project.py's `frame_uniform`.

struct Frame {
    focal: vec2f,        // pixels
    center: vec2f,       // principal point minus `origin`, pixels
    slope_low: vec2f,    // x/z and y/z beyond which the Jacobian stays as it is
    slope_high: vec2f,
    origin: vec2f,       // whole pixels; image coordinates are relative to it, so that they stay exact
    near: f32,
    unused: u32,
    size: vec2u,         // pixels
    tiles: vec2u,
    background: vec4f,   // red, green, blue; alpha stays that of the splats
}
