// Sort: one pass of a stable radix sort of keys with values.
//
// `count` and `scatter` cut the keys into blocks of THREADS runs of RUN keys, one run per
// invocation. Each invocation counts the digits of its own run, in its own column of `counters`,
// so no two meet and nothing depends on which is first. Between them `scan` (scan.wgsl) turns the
// histogram of all blocks, digit-major, into first places. No subgroups, no waiting for others.

struct Digit {
    shift: u32,
    bits: u32,
    source: u32,   // which of the counts says how many keys there are
    first: u32,    // 1: the values are the keys' own places, and keys that are ABSENT are left out
}

@group(0) @binding(0) var<uniform> digit: Digit;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> keys_in: array<vec4u>;    // four at once: drivers on
@group(0) @binding(3) var<storage, read> values_in: array<vec4u>;  // CPUs pay by the read
@group(0) @binding(4) var<storage, read_write> histogram: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

const BLOCK = THREADS * RUN;

var<workgroup> counters: array<u32, DIGITS * THREADS>;

fn count_run(block: u32, thread: u32, total: u32) {
    for (var d = 0u; d < (1u << digit.bits); d++) {
        counters[d * THREADS + thread] = 0u;
    }
    let start = block * BLOCK + thread * RUN;
    let end = min(start + RUN, total);
    let mask = (1u << digit.bits) - 1u;
    for (var i = start; i < end; i += 4u) {
        let keys = keys_in[i / 4u];
//!repeat AT FOUR
        {
            let key = keys[AT];
            if (i + ATu < end && (digit.first == 0u || key != ABSENT)) {
                counters[((key >> digit.shift) & mask) * THREADS + thread] += 1u;
            }
        }
//!end
    }
}

@compute @workgroup_size(THREADS)
fn count(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let total = counts[digit.source];
    let blocks = (total + BLOCK - 1u) / BLOCK;
    count_run(group.x, local.x, total);
    workgroupBarrier();
    for (var d = local.x; d < (1u << digit.bits); d += THREADS) {
        var sum = 0u;
        for (var t = 0u; t < THREADS; t++) {
            sum += counters[d * THREADS + t];
        }
        if (group.x < blocks) {
            histogram[d * blocks + group.x] = sum;
        }
    }
}

@compute @workgroup_size(THREADS)
fn scatter(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let total = counts[digit.source];
    let blocks = (total + BLOCK - 1u) / BLOCK;
    count_run(group.x, local.x, total);
    workgroupBarrier();
    for (var d = local.x; d < (1u << digit.bits); d += THREADS) {
        var place = 0u;
        if (group.x < blocks) {
            place = histogram[d * blocks + group.x];
        }
        for (var t = 0u; t < THREADS; t++) {
            let own = counters[d * THREADS + t];
            counters[d * THREADS + t] = place;
            place += own;
        }
    }
    workgroupBarrier();
    let start = group.x * BLOCK + local.x * RUN;
    let end = min(start + RUN, total);
    let mask = (1u << digit.bits) - 1u;
    for (var i = start; i < end; i += 4u) {
        let keys = keys_in[i / 4u];
        var values = vec4u(i, i + 1u, i + 2u, i + 3u);
        if (digit.first == 0u) {
            values = values_in[i / 4u];
        }
//!repeat AT FOUR
        {
            let key = keys[AT];
            if (i + ATu < end && (digit.first == 0u || key != ABSENT)) {
                let at = ((key >> digit.shift) & mask) * THREADS + local.x;
                let place = counters[at];
                counters[at] = place + 1u;
                keys_out[place] = key;
                values_out[place] = values[AT];
            }
        }
//!end
    }
}
