"""From rows to means, in two readings of the files.

moments   number, mean and scatter of repeats, pooled rows, sums over shapes, noise of a reading
rows      the rows as they balance, in blocks of groups that repeat one shape, and their sums
repeats   the sums of all blocks as moments, and fingerprints of some rows
"""
