"""In which order are splats drawn: scan, radix sort, ties?"""
