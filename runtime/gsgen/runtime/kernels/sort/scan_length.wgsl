struct Scan {
    source: u32,      // which of the counts the length follows from
    block: u32,       // length = rows × ⌈counts[source] / block⌉
    rows: u32,
    effect: u32,      // what the total is: 0 nothing new, 1 the visible splats, 2 the pairs
}

const MANY = 0x7fffffffu;  // sums stop here instead of wrapping around

fn groups(amount: u32, size: u32) -> u32 {
    return (amount + size - 1u) / size;
}

fn length_for(amount: u32) -> u32 {
    return scan_of.rows * groups(amount, scan_of.block);
}
