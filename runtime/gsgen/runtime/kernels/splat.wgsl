// A splat: what is left of a Gaussian once it is projected. Three buffers of one vec4f each, so
// that none outgrows a binding before 8.4 million Gaussians.

struct Splat {
    mean: vec2f,         // pixels, relative to the frame's origin
    conic: vec3f,        // inverse 2D covariance: xx, xy, yy
    opacity: f32,
    depth: f32,          // along the camera's +z
    color: vec3f,
    variance: vec2f,     // 2D covariance: xx, yy
}

// The α of a Gaussian falls below CULL_OPACITY where dᵀ conic d exceeds this.
fn reach(opacity: f32) -> f32 {
    return 2.0 * log(opacity / CULL_OPACITY);
}
