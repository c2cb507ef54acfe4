// Scan: replace numbers by the sum of all before them, and write the total to the counts.
//
// One workgroup: each invocation sums a run, the sums are scanned, and each writes its run. If SHARE
// is above 1, the numbers are sums of blocks of SHARE numbers, which scan_blocks.wgsl computes.

//!include scan_sums

@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> numbers: array<u32>;

fn announce(slot: u32, amount: u32, sort_slot: u32, walk_slot: u32, walk_size: u32) {
    counts[slot] = amount;
    counts[sort_slot] = groups(amount, SORT_BLOCK);
    counts[walk_slot] = groups(amount, walk_size);
}

@compute @workgroup_size(THREADS)
fn scan(@builtin(local_invocation_id) local: vec3u) {
    let length = groups(length_for(counts[scan_of.source]), SHARE);
    let run = groups(length, THREADS);
    let start = min(local.x * run, length);
    let end = min(start + run, length);
    // Step 1: sum a run for each invocation. Sums saturate: a wrapped one would pass for room.
    var sum = 0u;
    for (var i = start; i < end; i++) {
        sum = min(sum + numbers[i], MANY);
    }
    // Step 2: scan the sums of the runs, and write each run from there.
    var before = sum_before(local.x, sum);
    for (var i = start; i < end; i++) {
        let number = numbers[i];
        numbers[i] = before;
        before = min(before + number, MANY);
    }
    // Step 3: the last invocation has the total, which later dispatches take their sizes from.
    if (local.x == THREADS - 1u) {
        if (scan_of.effect == 1u) {
            announce(VISIBLE, before, SORT_VISIBLE_GROUPS, WALK_VISIBLE_GROUPS, WALK_BLOCK);
            counts[DRAW_ARGUMENTS + 1u] = before;
        }
        if (scan_of.effect == 2u) {
            counts[WANTED_PAIRS] = before;
            announce(PAIRS, min(before, counts[PAIR_CAPACITY]), SORT_PAIRS_GROUPS, WALK_PAIRS_GROUPS, RANGE_BLOCK);
        }
    }
}
