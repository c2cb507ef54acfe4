// Subgroups: measure how many invocations of a workgroup run in lockstep.

@group(0) @binding(0) var<storage, read_write> sizes: array<u32>;

@compute @workgroup_size(THREADS)
fn measure(@builtin(local_invocation_index) index: u32, @builtin(subgroup_size) size: u32) {
    sizes[index] = size;
}
