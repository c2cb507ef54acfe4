// Place splats: give the rows of a page that are in a slab their indices in the slab's arrays.
//
// Splats are numbered in the order of rows. A page is divided into blocks of THREADS runs of RUN
// rows. `count` counts the splats of each block; `place` numbers them after those of all blocks and
// pages before. No workgroup waits for another.

//!include page
//!include slab
//!include prefix_sums

@group(0) @binding(2) var<storage, read_write> block_counts: array<u32>;
@group(0) @binding(3) var<storage, read_write> ends: array<u32>;       // splats before this page and, PAGE_STEP later, after it
@group(0) @binding(4) var<storage, read_write> places: array<u32>;     // by row: the index of its splat, or ABSENT
@group(0) @binding(5) var<storage, read> row_origins: array<u32>;      // by row: its index in the order of the sets, if ARRANGED
@group(0) @binding(6) var<storage, read_write> origins: array<u32>;    // by splat: the same
@group(0) @binding(7) var<storage, read_write> takers: array<vec4f>;   // by splat: both halves of it, as floats; may be too short
@group(0) @binding(8) var<storage, read_write> counts: array<u32>;

const BLOCK = THREADS * RUN;

var<workgroup> splats_before: u32;

fn splats_in_run(start: u32) -> u32 {
    var splats = 0u;
    for (var own = start; own < min(start + RUN, page.capacity); own++) {
        splats += select(0u, 1u, is_in_slab(keys[own]));
    }
    return splats;
}

@compute @workgroup_size(THREADS)
fn count(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let splats = splats_in_run(group.x * BLOCK + thread * RUN);
    let before = sum_before(thread, splats);
    if (thread == THREADS - 1u) {
        block_counts[group.x] = before + splats;
    }
}

fn write_splat(own: u32, place: u32) {
    var origin = page.base + own;
    if (ARRANGED) {
        origin = row_origins[own];
    }
    places[own] = place;
    origins[place] = origin;
    if (place < arrayLength(&takers)) {
        takers[place] = vec4f(f32(origin >> 16u), f32(origin & 0xffffu), 0.0, 0.0);
    }
}

@compute @workgroup_size(THREADS)
fn place(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups_of_page: vec3u,
    @builtin(local_invocation_index) thread: u32,
) {
    // Step 1: sum the splats of all blocks and pages before.
    var sum = 0u;
    for (var block = thread; block < group.x; block += THREADS) {
        sum += block_counts[block];
    }
    let before = sum_before(thread, sum);
    if (thread == THREADS - 1u) {
        splats_before = ends[0] + before + sum;
    }
    // Step 2: number the splats of each run.
    let start = group.x * BLOCK + thread * RUN;
    let splats = splats_in_run(start);
    var next = sum_before(thread, splats) + splats_before;
    for (var own = start; own < min(start + RUN, page.capacity); own++) {
        if (is_in_slab(keys[own])) {
            write_splat(own, next);
            next += 1u;
        } else {
            places[own] = ABSENT;
        }
    }
    // Step 3: the last run knows the end of the page.
    if (thread == THREADS - 1u && group.x == groups_of_page.x - 1u) {
        ends[PAGE_STEP] = next;
        // Cells that are not empty take at least one slot.
        counts[GAUSSIANS] = min(next, max(next / max(page.per_slot, 1u), 1u));
    }
}
