// The tiles that a cell touches, for the kernel that counts them and the kernel that lists them.
//
// The bounds are those of Liu et al. 2025: whole tiles around a circle; pixel centres are integers.

//!include frame

// Return the first column and row of the box, and one past the last of both.
// mean: the circle's centre in pixels, relative to the frame's origin.

fn box_of(mean: vec2f, radius: f32, copy: u32) -> vec4u {
    var middle = mean + frame.origin - 0.5;
    var half_width = radius;
    if (PANORAMA) {
        half_width = min(radius, 0.5 * frame.period);
        middle.x += (f32(copy) - 1.0) * frame.period;
    }
    let extent = vec2f(half_width, radius);
    let most = vec2f(image_tiles());
    let begin = clamp(floor((middle - extent) / f32(TILE)), vec2f(0.0), most);
    let end = clamp(floor((middle + extent + f32(TILE - 1u)) / f32(TILE)), begin, most);
    return vec4u(vec2u(begin), vec2u(end));
}
