// Prefix sums over the invocations of a workgroup, which saturate instead of wrapping around.

const MANY = 0x7fffffffu;  // sums stop here
const SPAN = 16u;          // invocations whose numbers one of them adds up

var<workgroup> sums: array<u32, (THREADS + SPAN - 1u) / SPAN * SPAN>;

// Return the sum of `sum` over all lower invocations. Sums of spans need three barriers, and pairwise
// sums two a doubling, which are most of the cost on software drivers.
fn sum_before(thread: u32, sum: u32) -> u32 {
    workgroupBarrier();  // an earlier call may still be read
    sums[thread] = sum;
    workgroupBarrier();
    // Step 1: one invocation of each span replaces its numbers by the sums up to each.
    if (thread % SPAN == 0u) {
        var before = 0u;
        for (var i = thread; i < min(thread + SPAN, THREADS); i++) {
            before = min(before + sums[i], MANY);
            sums[i] = before;
        }
    }
    workgroupBarrier();
    // Step 2: add the sums of the spans before.
    var below = 0u;
    for (var last = SPAN - 1u; last < thread; last += SPAN) {
        below = min(below + sums[last], MANY);
    }
    if (thread % SPAN != 0u) {
        below = min(below + sums[thread - 1u], MANY);
    }
    return below;
}

// Return how many groups of `size` hold `amount`.
fn groups(amount: u32, size: u32) -> u32 {
    return (amount + size - 1u) / size;
}
