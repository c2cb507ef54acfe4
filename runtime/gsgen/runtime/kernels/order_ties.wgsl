// Order ties: sorted splats of one depth stand as their sets have them.
//
// Where rows are arranged in memory, a stable sort leaves equal depths as they are there. Each
// invocation looks at RUN sorted splats, and orders every tie that begins among them. One of more
// than MOST_TIED is left as it is, and announced: then rows must not be arranged.

@group(0) @binding(0) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read> origins: array<u32>;  // where splats are by the order of the sets
@group(0) @binding(3) var<storage, read_write> order: array<u32>;

fn order_tie(first: u32, key: u32, visible: u32) {
    var last = first + 2u;
    while (last < visible && last - first <= MOST_TIED && keys[last] == key) {
        last += 1u;
    }
    if (last - first > MOST_TIED) {
        atomicStore(&counts[TIED], 1u);
        return;
    }
    for (var i = first + 1u; i < last; i++) {
        let own = order[i];
        var place = i;
        while (place > first && origins[order[place - 1u]] > origins[own]) {
            order[place] = order[place - 1u];
            place -= 1u;
        }
        order[place] = own;
    }
}

@compute @workgroup_size(THREADS)
fn order_ties(@builtin(global_invocation_id) invocation: vec3u) {
    let visible = atomicLoad(&counts[VISIBLE]);
    let start = invocation.x * RUN;
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
        if (key == next && key != before) {
            order_tie(i, key, visible);
        }
        before = key;
        key = next;
    }
}
