// The uniform that all triangles of a mesh share; `mesh_uniform` of mesh_place.py writes it.

struct Place {
    linear: mat3x3f,     // local → camera, without the translation
    upright: mat3x3f,    // local → camera of normals: the inverse transpose of `linear`
    eye: vec3f,          // the camera centre in local space, rounded …
    shaded: u32,         // 1: lit by a light at the camera
    eye_rest: vec3f,     // … and the rounding error
    conversion: u32,     // of colours: 0 none, 1 to linear, 2 to sRGB
    focal: vec2f,        // pixels
    center: vec2f,       // principal point, pixels
    size: vec2f,         // of the image, pixels
    near: f32,
    is_flat: u32,        // 1: an orthographic camera
    textured: u32,
    period: f32,         // of a panorama: pixels of a full turn
}

@group(0) @binding(0) var<uniform> place: Place;
