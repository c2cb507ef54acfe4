// Scan: replace numbers by the sum of all before them, and say what the total was.
//
// One workgroup; each invocation sums a run, the sums are scanned, each writes its run. Where there
// are many numbers, these are the sums of blocks of SHARE each, which scan_blocks.wgsl makes.

//!include scan_length

@group(0) @binding(0) var<uniform> scan_of: Scan;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> numbers: array<u32>;

var<workgroup> sums: array<u32, THREADS>;

fn announce(slot: u32, amount: u32, sort_at: u32, walk_at: u32, walk_size: u32) {
    counts[slot] = amount;
    counts[sort_at] = groups(amount, SORT_BLOCK);
    counts[walk_at] = groups(amount, walk_size);
}

@compute @workgroup_size(THREADS)
fn scan(@builtin(local_invocation_id) local: vec3u) {
    let length = groups(length_for(counts[scan_of.source]), SHARE);
    let run = groups(length, THREADS);
    let start = min(local.x * run, length);
    let end = min(start + run, length);
    var sum = 0u;
    for (var i = start; i < end; i++) {
        sum = min(sum + numbers[i], MANY);
    }
//!include scan_sums
    var place = 0u;
    if (local.x > 0u) {
        place = sums[local.x - 1u];
    }
    for (var i = start; i < end; i++) {
        let own = numbers[i];
        numbers[i] = place;
        place = min(place + own, MANY);
    }
    if (local.x == THREADS - 1u) {
        if (scan_of.effect == 1u) {
            announce(VISIBLE, place, SORT_VISIBLE_GROUPS, WALK_VISIBLE_GROUPS, WALK_BLOCK);
            counts[DRAW_ARGUMENTS + 1u] = place;
        }
        if (scan_of.effect == 2u) {
            counts[WANTED_PAIRS] = place;
            announce(PAIRS, min(place, counts[PAIR_CAPACITY]), SORT_PAIRS_GROUPS, WALK_PAIRS_GROUPS, RANGE_BLOCK);
        }
    }
}
