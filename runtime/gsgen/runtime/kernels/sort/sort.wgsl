// Sort: one pass of a stable radix sort of keys with values.
//
// `count` and `scatter` divide the keys into blocks of THREADS runs of RUN keys, one run per
// invocation. Each invocation counts the digits of its own run in its own column of `counters`, so
// the result does not depend on timing. Between them `scan` (scan.wgsl) converts the histogram of
// all blocks, digit-major, to first indices. The sort uses no subgroups, and no workgroup waits for
// another.

struct Digit {
    shift: u32,
    bits: u32,
    source: u32,   // index of the count that holds the number of keys
    first: u32,    // 1: values are the indices of the keys, and ABSENT keys are dropped
}

@group(0) @binding(0) var<uniform> digit: Digit;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> keys_in: array<vec4u>;    // four at once: on software
@group(0) @binding(3) var<storage, read> values_in: array<vec4u>;  // drivers every read costs the same
@group(0) @binding(4) var<storage, read_write> histogram: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

const BLOCK = THREADS * RUN;

var<workgroup> counters: array<u32, DIGITS * THREADS>;

// Return the index of the counter of a key's digit, in the column of an invocation.
fn counter_of(key: u32, thread: u32) -> u32 {
    return ((key >> digit.shift) & ((1u << digit.bits) - 1u)) * THREADS + thread;
}

fn is_sorted(key: u32, i: u32, end: u32) -> bool {
    return i < end && (digit.first == 0u || key != ABSENT);
}

// Return where the histogram of a block's runs begins, after those of all blocks.
fn runs_of(block: u32) -> u32 {
    return arrayLength(&histogram) / (THREADS + 1u) + block * DIGITS * THREADS;
}

fn count_key(key: u32, i: u32, end: u32, thread: u32) {
    if (is_sorted(key, i, end)) {
        counters[counter_of(key, thread)] += 1u;
    }
}

fn count_run(block: u32, thread: u32, total: u32) {
    for (var d = 0u; d < (1u << digit.bits); d++) {
        counters[d * THREADS + thread] = 0u;
    }
    let start = block * BLOCK + thread * RUN;
    let end = min(start + RUN, total);
    for (var i = start; i < end; i += 4u) {
        let keys = keys_in[i / 4u];
        count_key(keys.x, i, end, thread);
        count_key(keys.y, i + 1u, end, thread);
        count_key(keys.z, i + 2u, end, thread);
        count_key(keys.w, i + 3u, end, thread);
    }
}

@compute @workgroup_size(THREADS)
fn count(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let total = counts[digit.source];
    let blocks = (total + BLOCK - 1u) / BLOCK;
    // Step 1: count the digits of each run, each in a column of its own: no atomics, no timing.
    count_run(group.x, local.x, total);
    workgroupBarrier();
    if (group.x >= blocks) {
        return;
    }
    // Step 2: for each digit, replace the amounts of the runs by sums of those before, and add up the block.
    let runs = runs_of(group.x);
    for (var d = local.x; d < (1u << digit.bits); d += THREADS) {
        var sum = 0u;
        for (var t = 0u; t < THREADS; t++) {
            histogram[runs + d * THREADS + t] = sum;
            sum += counters[d * THREADS + t];
        }
        histogram[d * blocks + group.x] = sum;
    }
}

fn scatter_key(key: u32, value: u32, i: u32, end: u32, thread: u32) {
    if (is_sorted(key, i, end)) {
        let counter = counter_of(key, thread);
        let index = counters[counter];
        counters[counter] = index + 1u;
        keys_out[index] = key;
        values_out[index] = value;
    }
}

@compute @workgroup_size(THREADS)
fn scatter(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let total = counts[digit.source];
    let blocks = (total + BLOCK - 1u) / BLOCK;
    if (group.x >= blocks) {
        return;
    }
    // Step 1: read where the keys of each digit begin, in this run.
    let runs = runs_of(group.x);
    for (var d = 0u; d < (1u << digit.bits); d++) {
        let first = histogram[d * blocks + group.x];
        counters[d * THREADS + local.x] = first + histogram[runs + d * THREADS + local.x];
    }
    // Step 2: write each key of the run where its counter points, in order, so that the sort is stable.
    let start = group.x * BLOCK + local.x * RUN;
    let end = min(start + RUN, total);
    for (var i = start; i < end; i += 4u) {
        let keys = keys_in[i / 4u];
        var values = vec4u(i, i + 1u, i + 2u, i + 3u);
        if (digit.first == 0u) {
            values = values_in[i / 4u];
        }
        scatter_key(keys.x, values.x, i, end, local.x);
        scatter_key(keys.y, values.y, i + 1u, end, local.x);
        scatter_key(keys.z, values.z, i + 2u, end, local.x);
        scatter_key(keys.w, values.w, i + 3u, end, local.x);
    }
}
