    // Where `emit` begins: its run of the order, and its place among the pairs.
    let visible = counts[VISIBLE];
    let end = min((invocation.x + 1u) * RUN, visible);
    let room = counts[PAIR_CAPACITY];
    var place = 0u;
    if (invocation.x * RUN < visible) {
        place = run_pairs[invocation.x];
    }
