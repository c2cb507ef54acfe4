// The digits of the first pass of a staged sort, counted by the kernel that writes the keys.
//
// Their histogram has a row for each of DIGITS, and a column for each block of SORT_BLOCK keys. Its
// numbers are zero when a frame begins.

// Return the index of a digit's counter in a histogram of a length, for the key at an index.
fn counter_of(value: u32, index: u32, length: u32) -> u32 {
    return value * (length / DIGITS) + index / SORT_BLOCK;
}
