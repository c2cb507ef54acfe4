// The shared part of the scan kernels: the number of values, and prefix sums in a workgroup.

//!include prefix_sums

struct Scan {
    source: u32,      // index of the count that the length follows from
    block: u32,       // length = rows × ⌈counts[source] / block⌉
    rows: u32,
    effect: u32,      // the count that receives the total: 0 none, 1 visible splats, 2 pairs
}

@group(0) @binding(0) var<uniform> scan_of: Scan;

fn length_for(amount: u32) -> u32 {
    return scan_of.rows * groups(amount, scan_of.block);
}
