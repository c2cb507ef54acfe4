    // `sums` of a workgroup: in place of each invocation's `sum`, that of all up to it.
    sums[local.x] = sum;
    workgroupBarrier();
    for (var reach = 1u; reach < THREADS; reach *= 2u) {
        var below = 0u;
        if (local.x >= reach) {
            below = sums[local.x - reach];
        }
        workgroupBarrier();
        sums[local.x] = min(sums[local.x] + below, MANY);
        workgroupBarrier();
    }
