// The slot table of a pool's page: what the present frame draws of each slot.
//
// `slot_table` of slots.py writes it every frame.

//!include page

struct Slot {
    eye: vec3f,          // the camera centre relative to the slot's origin, rounded …
    fade: f32,           // factor on opacities; 0 if the slot is not drawn
    eye_rest: vec3f,     // … and the rounding error
    live: u32,           // rows that hold Gaussians
    eye_at: vec3f,       // the rounded `eye` in camera space …
    eye_at_rest: vec3f,  // … and its rounding error
    low: vec3f,          // box around the slot's splats, relative to its origin
    high: vec3f,
}

@group(1) @binding(3) var<uniform> slots: array<Slot, PAGE_SLOTS>;

fn slot_eye(slot: u32) -> Eye {
    return Eye(slots[slot].eye, slots[slot].eye_rest, slots[slot].eye_at, slots[slot].eye_at_rest);
}
