"""Sorting splats on the GPU: prefix sums, radix sort, and equal depths."""
