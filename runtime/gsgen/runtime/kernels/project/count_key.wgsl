// Count the first digit of the sort key of a splat. The low bits of depths differ from splat to splat,
// so that a workgroup's 64 keys have nearly as many digits: they are not summed in its memory first.

//!include first_digits

@group(0) @binding(6) var<storage, read_write> histogram: array<atomic<u32>>;

fn count_key(key: u32, index: u32) {
    if (key != ABSENT) {
        atomicAdd(&histogram[counter_of(key % DIGITS, index, arrayLength(&histogram))], 1u);
    }
}
