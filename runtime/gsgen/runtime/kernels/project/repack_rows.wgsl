// Repack rows: copy rows of numbers into rows of whole words, as pages store them.
//
// Rows of a generator follow each other without gaps, in float32 or float16. A page has float32
// rows, and appearance in whole vectors. Columns that a row lacks become zero.

@group(0) @binding(0) var<storage, read> numbers: array<u32>;
@group(0) @binding(1) var<storage, read_write> words: array<u32>;

fn half_bits(index: u32) -> u32 {
    return (numbers[index / 2u] >> (16u * (index % 2u))) & 0xffffu;
}

// Return the bits of a number in the target's format.
fn bits_at(row: u32, column: u32) -> u32 {
    if (column >= COLUMNS) {
        return 0u;
    }
    let index = row * COLUMNS + column;
    if (!HALF_SOURCE) {
        return numbers[index];
    }
    if (HALF_TARGET) {
        return half_bits(index);
    }
    return bitcast<u32>(unpack2x16float(half_bits(index)).x);
}

@compute @workgroup_size(THREADS)
fn repack(@builtin(global_invocation_id) id: vec3u) {
    let row = id.x;
    if (row >= arrayLength(&words) / WORDS) {
        return;
    }
    for (var word = 0u; word < WORDS; word++) {
        var bits = 0u;
        if (HALF_TARGET) {
            bits = bits_at(row, 2u * word) | (bits_at(row, 2u * word + 1u) << 16u);
        } else {
            bits = bits_at(row, word);
        }
        words[row * WORDS + word] = bits;
    }
}
