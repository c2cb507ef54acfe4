// Staged sort: one pass of a stable radix sort for GPUs, which orders keys in workgroup memory.
//
// A workgroup orders a block of THREADS × RUN keys by one digit in workgroup memory and writes them
// from there, so that keys of one digit go to neighbouring addresses. The histogram has a row per
// digit and a column per block. No pass reads its keys twice: the kernel that writes the keys counts
// their first digits (first_digits.wgsl), and `scatter` counts the next digit of each key in the
// column of the block that the key is written to. Where the keys' kernel does not count, `count` does
// before the first pass. `scan_rows` converts each row to sums, and clears the histogram of the next
// pass. No workgroup waits for another, and the result does not depend on timing.

//!include prefix_sums

struct Digit {
    shift: u32,
    bits: u32,
    source: u32,     // index of the count that holds the number of keys
    first: u32,      // 1: values are the indices of the keys, ABSENT keys are dropped, and a scan
                     // has converted `totals` to sums of all before them
    next_bits: u32,  // of the next pass; 0 in the last pass
    rows: u32,       // of a histogram: one for each digit of the longest pass
}

@group(0) @binding(0) var<uniform> digit: Digit;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> keys_in: array<u32>;
@group(0) @binding(3) var<storage, read> values_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> histogram: array<u32>;               // of this pass
@group(0) @binding(5) var<storage, read_write> next_histogram: array<atomic<u32>>;  // as large
@group(0) @binding(6) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(7) var<storage, read_write> values_out: array<u32>;
@group(0) @binding(8) var<storage, read_write> totals: array<u32>;  // keys of each digit

const BLOCK = THREADS * RUN;
const LANES = 32u;                            // bits of a mask
const MASKS = (THREADS + LANES - 1u) / LANES; // masks of a digit, one for each 32 invocations
const NOT_SORTED = ~0u;

var<workgroup> words: array<atomic<u32>, max(BLOCK, DIGITS * MASKS)>;  // masks; then keys; then values
var<workgroup> amounts: array<u32, DIGITS>;  // keys of the block, by digit
var<workgroup> firsts: array<u32, DIGITS>;   // index in the block of a digit's first key
var<workgroup> moves: array<u32, DIGITS>;    // what an index in the block lacks to the index in the output
var<workgroup> sorted_keys: u32;

fn digit_of(key: u32) -> u32 {
    return (key >> digit.shift) & ((1u << digit.bits) - 1u);
}

fn is_sorted(key: u32, i: u32, total: u32) -> bool {
    return i < total && (digit.first == 0u || key != ABSENT);
}

// Return the index of a digit's row in a histogram.
fn row_of(value: u32) -> u32 {
    return value * (arrayLength(&histogram) / digit.rows);
}

@compute @workgroup_size(THREADS)
fn count(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let total = counts[digit.source];
    // Step 1: count the digits of the block in workgroup memory, whose atomics are cheap.
    for (var d = local.x; d < DIGITS; d += THREADS) {
        atomicStore(&words[d], 0u);
    }
    workgroupBarrier();
    for (var round = 0u; round < RUN; round++) {
        let i = group.x * BLOCK + round * THREADS + local.x;
        if (i < total) {
            let key = keys_in[i];
            if (is_sorted(key, i, total)) {
                atomicAdd(&words[digit_of(key)], 1u);
            }
        }
    }
    workgroupBarrier();
    // Step 2: write them as the column of the block; the order of atomic additions does not show in sums.
    if (group.x < groups(total, BLOCK)) {
        for (var d = local.x; d < (1u << digit.bits); d += THREADS) {
            histogram[row_of(d) + group.x] = atomicLoad(&words[d]);
        }
    }
}

// As many workgroups as blocks share the rows: each takes one or more, and divides its invocations
// among them. Few keys so take few workgroups, whose invocations are most of the cost on CPUs.
@compute @workgroup_size(THREADS)
fn scan_rows(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let digits = 1u << digit.bits;
    let blocks = groups(counts[digit.source], BLOCK);
    let rows = groups(digits, max(blocks, 1u));  // of this workgroup, at most THREADS
    if (group.x * rows >= digits) {
        return;
    }
    let lanes = THREADS / rows;                  // invocations of a row
    let slot = local.x / lanes;
    let lane = local.x % lanes;
    let value = group.x * rows + slot;
    let is_row = slot < rows && value < digits;
    let row = row_of(value);
    // Step 1: sum the columns of each invocation.
    let run = groups(blocks, lanes);
    let start = select(blocks, min(lane * run, blocks), is_row);
    let end = min(start + run, blocks);
    var sum = 0u;
    for (var i = start; i < end; i++) {
        sum += histogram[row + i];
    }
    // Step 2: add the sums of the invocations before in the same row.
    let below = sum_before(local.x, sum);
    if (is_row && lane == 0u) {
        firsts[slot] = below;
    }
    workgroupBarrier();
    // Step 3: replace each column by the sum before it, and clear the histogram that this pass fills.
    var before = below - firsts[min(slot, rows - 1u)];
    for (var i = start; i < end; i++) {
        let amount = histogram[row + i];
        histogram[row + i] = before;
        if (digit.next_bits > 0u) {
            atomicStore(&next_histogram[row + i], 0u);
        }
        before += amount;
    }
    // Step 4: the last invocation of a row has the sum of all: the keys of the digit.
    if (is_row && lane == lanes - 1u) {
        totals[value] = before;
    }
}

// Return the rank of a key among those of its digit in the block, after all invocations have set
// their bit in the masks of this round.
fn rank_of(value: u32, thread: u32) -> u32 {
    let last = value * MASKS + thread / LANES;
    var rank = amounts[value];
    for (var mask = value * MASKS; mask < last; mask++) {
        rank += countOneBits(atomicLoad(&words[mask]));
    }
    return rank + countOneBits(atomicLoad(&words[last]) & ((1u << (thread % LANES)) - 1u));
}

// Add the keys of this round to the amounts of each digit, and clear the masks.
fn add_round(thread: u32) {
    for (var d = thread; d < DIGITS; d += THREADS) {
        var amount = amounts[d];
        for (var mask = d * MASKS; mask < (d + 1u) * MASKS; mask++) {
            amount += countOneBits(atomicLoad(&words[mask]));
            atomicStore(&words[mask], 0u);
        }
        amounts[d] = amount;
    }
}

// Compute where the keys of each digit begin: in the block, and in the output. DIGITS <= THREADS.
fn place_digits(block: u32, thread: u32) {
    let is_digit = thread < (1u << digit.bits);
    var amount = 0u;
    var total = 0u;
    if (is_digit) {
        amount = amounts[thread];
        total = totals[thread];
    }
    let first = sum_before(thread, amount);
    if (thread == THREADS - 1u) {
        sorted_keys = first + amount;
    }
    workgroupBarrier();
    let sum = sum_before(thread, total);
    if (is_digit) {
        let before = select(sum, total, digit.first != 0u);
        let start = before + histogram[row_of(thread) + block];
        firsts[thread] = first;
        moves[thread] = start - first;  // may wrap around, as the sum with an index then does
    }
    workgroupBarrier();
}

@compute @workgroup_size(THREADS)
fn scatter(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let thread = local.x;
    let start = group.x * BLOCK;
    let total = counts[digit.source];
    var keys: array<u32, RUN>;
    var indices: array<u32, RUN>;  // of the keys: ranks, and then indices in the block
    // Step 1: rank the keys of the block by their digits, THREADS keys a round.
    for (var d = thread; d < DIGITS; d += THREADS) {
        amounts[d] = 0u;
    }
    for (var mask = thread; mask < DIGITS * MASKS; mask += THREADS) {
        atomicStore(&words[mask], 0u);
    }
    workgroupBarrier();
    for (var round = 0u; round < RUN; round++) {
        let i = start + round * THREADS + thread;
        var key = ABSENT;
        if (i < total) {
            key = keys_in[i];
        }
        let is_present = is_sorted(key, i, total);
        let value = digit_of(key);
        if (is_present) {
            atomicOr(&words[value * MASKS + thread / LANES], 1u << (thread % LANES));
        }
        workgroupBarrier();
        keys[round] = key;
        indices[round] = NOT_SORTED;
        if (is_present) {
            indices[round] = rank_of(value, thread);
        }
        workgroupBarrier();
        add_round(thread);
        workgroupBarrier();
    }
    // Step 2: find the first index of each digit, in the block and in the output.
    place_digits(group.x, thread);
    // Step 3: order the keys in workgroup memory.
    for (var round = 0u; round < RUN; round++) {
        if (indices[round] != NOT_SORTED) {
            indices[round] += firsts[digit_of(keys[round])];
            atomicStore(&words[indices[round]], keys[round]);
        }
    }
    workgroupBarrier();
    // Step 4: write them, and count the digits of the next pass.
    var targets: array<u32, RUN>;
    for (var round = 0u; round < RUN; round++) {
        let index = round * THREADS + thread;
        if (index < sorted_keys) {
            let key = atomicLoad(&words[index]);
            let to = index + moves[digit_of(key)];
            targets[round] = to;
            keys_out[to] = key;
            if (digit.next_bits > 0u) {
                let next = (key >> (digit.shift + digit.bits)) & ((1u << digit.next_bits) - 1u);
                atomicAdd(&next_histogram[row_of(next) + to / BLOCK], 1u);
            }
        }
    }
    workgroupBarrier();
    // Step 5: the values follow their keys.
    for (var round = 0u; round < RUN; round++) {
        if (indices[round] != NOT_SORTED) {
            let i = start + round * THREADS + thread;
            var value = i;
            if (digit.first == 0u) {
                value = values_in[i];
            }
            atomicStore(&words[indices[round]], value);
        }
    }
    workgroupBarrier();
    for (var round = 0u; round < RUN; round++) {
        let index = round * THREADS + thread;
        if (index < sorted_keys) {
            values_out[targets[round]] = atomicLoad(&words[index]);
        }
    }
}
