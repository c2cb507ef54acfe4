// Gather keys: replace the sort keys by a second key of each splat, in sorted order.

@group(0) @binding(0) var<storage, read> counts: array<u32>;
@group(0) @binding(1) var<storage, read> keys: array<u32>;    // by splat
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read_write> keys_out: array<u32>;

@compute @workgroup_size(THREADS)
fn gather_keys(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let end = min((group.x + 1u) * BLOCK, counts[VISIBLE]);
    for (var i = group.x * BLOCK + local.x; i < end; i += THREADS) {
        keys_out[i] = keys[order[i]];
    }
}
