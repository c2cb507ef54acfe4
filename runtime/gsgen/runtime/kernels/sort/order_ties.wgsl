// Order ties: sort splats of equal keys by their depth remainders.
//
// Splats of equal depth are sorted by their sets; where rows are ARRANGED in memory, the stable sort
// has left them in the order of memory. Each invocation looks at RUN sorted splats, and sorts every
// tie that begins among them by insertion, which is the fastest for a few. A tie of more than
// MOST_TIED stays as it is, so that no invocation takes long. If it is not in order, the kernel sets
// UNSORTED (depths are out of order) or TIED (only sets are), and the frame is drawn again.

@group(0) @binding(0) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(1) var<storage, read> keys: array<vec4u>;  // four at once: on software drivers every read costs the same
@group(0) @binding(2) var<storage, read> lows: array<u32>;     // by splat: depth remainders, as bits that sort alike
@group(0) @binding(3) var<storage, read_write> order: array<u32>;
@group(0) @binding(4) var<storage, read> origins: array<u32>;  // by splat: its index in the order of the sets, if ARRANGED

fn key_at(rank: u32) -> u32 {
    return keys[rank / 4u][rank % 4u];
}

fn origin_of(splat: u32) -> u32 {
    if (ARRANGED) {
        return origins[splat];
    }
    return splat;
}

// Set UNSORTED or TIED if two neighbours in a tie that is too long are out of order.
fn check(rank: u32) {
    let first = order[rank];
    let second = order[rank + 1u];
    if (lows[first] > lows[second]) {
        atomicStore(&counts[UNSORTED], 1u);
    } else if (lows[first] == lows[second] && origin_of(first) > origin_of(second)) {
        atomicStore(&counts[TIED], 1u);
    }
}

fn order_tie(first: u32, key: u32, visible: u32) {
    // Step 1: find the end of the tie, or stop if it is too long.
    var end = first + 2u;
    while (end < visible && end - first <= MOST_TIED && key_at(end) == key) {
        end += 1u;
    }
    // Step 2: a tie that is too long is only checked, here for its first MOST_TIED splats.
    if (end - first > MOST_TIED) {
        for (var i = first; i < first + MOST_TIED; i++) {
            check(i);
        }
        return;
    }
    // Step 3: sort by insertion.
    for (var i = first + 1u; i < end; i++) {
        let splat = order[i];
        let low = lows[splat];
        var rank = i;
        while (rank > first) {
            let before = order[rank - 1u];
            let low_before = lows[before];
            if (low_before < low || (low_before == low && origin_of(before) < origin_of(splat))) {
                break;
            }
            order[rank] = before;
            rank -= 1u;
        }
        order[rank] = splat;
    }
}

// Workgroups have two dimensions: millions of splats exceed the limit of one.
@compute @workgroup_size(THREADS)
fn order_ties(@builtin(global_invocation_id) invocation: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let visible = atomicLoad(&counts[VISIBLE]);
    let start = (invocation.y * groups.x * THREADS + invocation.x) * RUN;
    let end = min(start + RUN, visible);
    if (start >= end) {
        return;
    }
    var four = keys[start / 4u];
    for (var first = start / 4u * 4u; first < end; first += 4u) {
        let next = keys[first / 4u + 1u];
        // A bit for each splat that has the key of the next one, which few have.
        let bits = select(vec4u(0u), vec4u(1u, 2u, 4u, 8u), four == vec4u(four.yzw, next.x));
        var tied = bits.x | bits.y | bits.z | bits.w;
        while (tied != 0u) {
            let rank = first + firstTrailingBit(tied);
            tied &= tied - 1u;
            if (rank >= start && rank < end && rank + 1u < visible) {
                let key = key_at(rank);
                if (rank == 0u || key_at(rank - 1u) != key) {
                    order_tie(rank, key, visible);
                } else if (rank >= MOST_TIED && key_at(rank - MOST_TIED) == key) {
                    check(rank);  // `order_tie` checks the first MOST_TIED
                }
            }
        }
        four = next;
    }
}
