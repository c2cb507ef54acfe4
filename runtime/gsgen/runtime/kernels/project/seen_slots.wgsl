// The slots of a pool's page that may be seen, for kernels that run SLOT_ROWS / THREADS workgroups each.

//!include slots

// In any order, four in a vector. `cull_slots` writes it; it is a uniform because no more than eight
// storage buffers can be bound everywhere.
@group(1) @binding(4) var<uniform> seen: array<vec4u, PAGE_SLOTS / 4u>;

fn slot_of(workgroup: u32) -> u32 {
    let number = workgroup / (SLOT_ROWS / THREADS);
    return seen[number / 4u][number % 4u];
}

fn row_of_slot(workgroup: u32, thread: u32) -> u32 {
    return workgroup % (SLOT_ROWS / THREADS) * THREADS + thread;
}
