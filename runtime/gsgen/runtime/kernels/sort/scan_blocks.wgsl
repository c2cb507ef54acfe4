// Scan of many numbers: the kernels before and after the scan (scan.wgsl) of the sums of blocks.
//
// `reduce` sums each block of THREADS × RUN numbers; `spread` replaces the numbers of each block by
// the sums of all before them, after the sums of the blocks were scanned. No workgroup waits for
// another.

//!include scan_sums

@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> numbers: array<u32>;
@group(0) @binding(3) var<storage, read_write> block_sums: array<u32>;

const BLOCK = THREADS * RUN;

var<workgroup> block: array<u32, BLOCK>;

@compute @workgroup_size(THREADS)
fn reduce(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let length = length_for(counts[scan_of.source]);
    let start = group.x * BLOCK;
    let end = min(start + BLOCK, length);
    // Step 1: sum every THREADS-th number, so that neighbours read neighbouring addresses.
    var sum = 0u;
    for (var i = start + local.x; i < end; i += THREADS) {
        sum = min(sum + numbers[i], MANY);
    }
    sums[local.x] = sum;
    workgroupBarrier();
    // Step 2: add up the invocations, half of them at a time.
    for (var half = THREADS / 2u; half > 0u; half /= 2u) {
        if (local.x < half) {
            sums[local.x] = min(sums[local.x] + sums[local.x + half], MANY);
        }
        workgroupBarrier();
    }
    if (local.x == 0u && start < length) {
        block_sums[group.x] = sums[0];
    }
}

@compute @workgroup_size(THREADS)
fn spread(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let length = length_for(counts[scan_of.source]);
    let start = group.x * BLOCK;
    // Step 1: read the block into workgroup memory, neighbours by neighbours.
    for (var k = local.x; k < BLOCK; k += THREADS) {
        var number = 0u;
        if (start + k < length) {
            number = numbers[start + k];
        }
        block[k] = number;
    }
    workgroupBarrier();
    // Step 2: scan the runs; all blocks before add their sum.
    let run = local.x * RUN;
    var sum = 0u;
    for (var k = run; k < run + RUN; k++) {
        sum = min(sum + block[k], MANY);
    }
    var before = sum_before(local.x, sum);
    if (start < length) {
        before = min(block_sums[group.x] + before, MANY);
    }
    for (var k = run; k < run + RUN; k++) {
        let number = block[k];
        block[k] = before;
        before = min(before + number, MANY);
    }
    workgroupBarrier();
    // Step 3: write the block back.
    for (var k = local.x; k < BLOCK; k += THREADS) {
        if (start + k < length) {
            numbers[start + k] = block[k];
        }
    }
}
