"""From rows to means.

moments   number, mean and scatter of repeats, pooled rows, sums over shapes, noise of a reading
rows      the rows as they balance, in groups that repeat one shape
repeats   the moments of rows, and fingerprints of some of them
"""
