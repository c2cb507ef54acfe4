// The shared part of the scan kernels: the number of values, and prefix sums in a workgroup.

struct Scan {
    source: u32,      // index of the count that the length follows from
    block: u32,       // length = rows × ⌈counts[source] / block⌉
    rows: u32,
    effect: u32,      // the count that receives the total: 0 none, 1 visible splats, 2 pairs
}

@group(0) @binding(0) var<uniform> scan_of: Scan;

const MANY = 0x7fffffffu;  // sums stop here instead of wrapping around

var<workgroup> sums: array<u32, THREADS>;

fn groups(amount: u32, size: u32) -> u32 {
    return (amount + size - 1u) / size;
}

fn length_for(amount: u32) -> u32 {
    return scan_of.rows * groups(amount, scan_of.block);
}

// Return the sum of `sum` over all lower invocations; `sums` gets the sums up to each invocation.
fn sum_before(thread: u32, sum: u32) -> u32 {
    sums[thread] = sum;
    workgroupBarrier();
    // Hillis and Steele 1986: each step adds the sums of twice as many invocations.
    for (var reach = 1u; reach < THREADS; reach *= 2u) {
        var below = 0u;
        if (thread >= reach) {
            below = sums[thread - reach];
        }
        workgroupBarrier();
        sums[thread] = min(sums[thread] + below, MANY);
        workgroupBarrier();
    }
    if (thread == 0u) {
        return 0u;
    }
    return sums[thread - 1u];
}
