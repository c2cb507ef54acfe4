// The uniform of a slab: the splats of a frame whose sort keys are in a range.

struct Slab {
    low: u32,    // first key
    high: u32,   // one past the last key
    shift: u32,  // low bits of a key that tally_keys.wgsl leaves out
}

@group(0) @binding(0) var<uniform> slab: Slab;
@group(0) @binding(1) var<storage, read> keys: array<u32>;  // by row of the page

fn is_in_slab(key: u32) -> bool {
    return key >= slab.low && key < slab.high;
}
