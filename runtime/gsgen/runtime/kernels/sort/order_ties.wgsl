// Order ties: sorted splats whose keys are the same stand by the rest of their depths.
//
// Of depths that are the same altogether, the one comes first that its set has first; where rows
// are ARRANGED in memory, a stable sort has left them as they are there. Each invocation looks at
// RUN sorted splats, and orders every tie that begins among them: by insertion, for it is short.
// One of more than MOST_TIED is left as it is, and nobody writes there; if it is not in order
// anyway, that is announced: as UNSORTED where depths are not, as TIED where only sets are not.

@group(0) @binding(0) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read> lows: array<u32>;  // by splat: bits that sort as what a key leaves of a depth
@group(0) @binding(3) var<storage, read_write> order: array<u32>;
//!repeat ONCE ARRANGED
@group(0) @binding(4) var<storage, read> origins: array<u32>;  // by splat: where it is by the order of the sets
//!end

fn origin_of(splat: u32) -> u32 {
//!repeat ONCE ARRANGED
    return origins[splat];
//!end
    return splat;
}

// Announce what is wrong with two neighbours in a tie that is too long.
fn check(place: u32) {
    let one = order[place];
    let next = order[place + 1u];
    if (lows[one] > lows[next]) {
        atomicStore(&counts[UNSORTED], 1u);
    } else if (lows[one] == lows[next] && origin_of(one) > origin_of(next)) {
        atomicStore(&counts[TIED], 1u);
    }
}

fn order_tie(first: u32, key: u32, visible: u32) {
    var last = first + 2u;
    while (last < visible && last - first <= MOST_TIED && keys[last] == key) {
        last += 1u;
    }
    if (last - first > MOST_TIED) {
        for (var i = first; i < first + MOST_TIED; i++) {
            check(i);
        }
        return;
    }
    for (var i = first + 1u; i < last; i++) {
        let own = order[i];
        let low = lows[own];
        var place = i;
        while (place > first) {
            let before = order[place - 1u];
            let its_low = lows[before];
            if (its_low < low || (its_low == low && origin_of(before) < origin_of(own))) {
                break;
            }
            order[place] = before;
            place -= 1u;
        }
        order[place] = own;
    }
}

// Millions of splats are too many for one line of workgroups.
@compute @workgroup_size(THREADS)
fn order_ties(@builtin(global_invocation_id) invocation: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let visible = atomicLoad(&counts[VISIBLE]);
    let start = (invocation.y * groups.x * THREADS + invocation.x) * RUN;
    let end = min(start + RUN, visible);
    if (start >= end) {
        return;
    }
    var before = ABSENT;
    if (start > 0u) {
        before = keys[start - 1u];
    }
    var key = keys[start];
    for (var i = start; i < end; i++) {
        var next = ABSENT;
        if (i + 1u < visible) {
            next = keys[i + 1u];
        }
        if (key == next) {
            if (key != before) {
                order_tie(i, key, visible);
            } else if (i >= MOST_TIED && keys[i - MOST_TIED] == key) {
                check(i);  // the first of the tie are checked where it begins
            }
        }
        before = key;
        key = next;
    }
}
