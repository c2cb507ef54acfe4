// How many tiles each run of the order has. Needs `tiles_of`, which tells it of one member.

@compute @workgroup_size(THREADS)
fn measure(@builtin(global_invocation_id) invocation: vec3u) {
    let visible = counts[VISIBLE];
    let end = min((invocation.x + 1u) * RUN, visible);
    var pairs = 0u;
    for (var rank = invocation.x * RUN; rank < end; rank++) {
        pairs += tiles_of(order[rank]);
    }
    if (invocation.x * RUN < visible) {
        run_pairs[invocation.x] = pairs;
    }
}
