// Cull slots: list the slots of a pool's page that may be seen, and make all other keys ABSENT.
//
// One workgroup per slot. A slot is dropped if it is not drawn, or if the box around its splats
// lies behind the near plane, or outside of one of four planes through the camera centre: those to
// whose slopes Jacobians are clamped, CULL_MARGIN images beyond the sides. Beyond them the ellipse of
// a splat reaches as far as its ellipsoid, except for the dilation. That does not hold for lenses,
// whose slots are all listed.

//!include frame
//!include page
//!include slots

@group(0) @binding(1) var<storage, read_write> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> lows: array<u32>;
@group(0) @binding(3) var<storage, read_write> seen: array<u32>;                 // slots that may be seen
@group(0) @binding(4) var<storage, read_write> dispatch: array<atomic<u32>, 3>;  // workgroups of project_pooled

var<workgroup> is_seen: u32;

// Return the greatest of dot(plane, p) over the points p of a box, in camera space. The box is
// given in local space, relative to the eye.
fn greatest(plane: vec3f, middle: vec3f, extent: vec3f) -> f32 {
    let normal = plane * page.linear;
    return dot(normal, middle) + dot(abs(normal), extent);
}

fn may_be_seen(slot: u32) -> bool {
    if (!(slots[slot].fade > 0.0) || slots[slot].live == 0u) {
        return false;
    }
    let dilation = REACH * sqrt(DILATION + frame.extra_dilation);
    if (PANORAMA || FISHEYE || DISTORTED || is_flat() || any(CULL_MARGIN * vec2f(frame.size) < vec2f(dilation))) {
        return true;
    }
    let extent = 0.5 * (slots[slot].high - slots[slot].low);
    let middle = (slots[slot].low + extent - eye.at) - eye.rest;
    let low = frame.slope_low;
    let high = frame.slope_high;
    // Boxes of numbers that are not finite are kept: `project` drops their rows.
    return !(greatest(vec3f(0.0, 0.0, 1.0), middle, extent) <= frame.near)
        && !(greatest(vec3f(1.0, 0.0, -low.x), middle, extent) < 0.0)
        && !(greatest(vec3f(-1.0, 0.0, high.x), middle, extent) < 0.0)
        && !(greatest(vec3f(0.0, 1.0, -low.y), middle, extent) < 0.0)
        && !(greatest(vec3f(0.0, -1.0, high.y), middle, extent) < 0.0);
}

@compute @workgroup_size(THREADS)
fn cull_slots(
    @builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) thread: u32
) {
    // Step 1: one invocation decides, and adds the slot to the list and to the dispatch of projection.
    let slot = workgroup.x;
    if (thread == 0u) {
        eye = slot_eye(slot);
        is_seen = select(0u, 1u, may_be_seen(slot));
        if (is_seen == 1u) {
            let groups = SLOT_ROWS / THREADS;
            seen[atomicAdd(&dispatch[0], groups) / groups] = slot;
        }
    }
    if (workgroupUniformLoad(&is_seen) == 1u) {
        return;
    }
    // Step 2: no projection writes the rows of other slots, so their keys are written here.
    for (var row = thread; row < SLOT_ROWS; row += THREADS) {
        let own = slot * SLOT_ROWS + row;
        keys[select(page.base + own, own, KEYS_ONLY)] = ABSENT;
        if (!KEYS_ONLY) {
            lows[page.base + own] = ABSENT;
        }
    }
}
