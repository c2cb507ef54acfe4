"""Which passes replace scatters, slices, samplers and hashes by gathers from tables?"""
