"""From rows to means, in two readings of the files.

rows            rows of a cycle as they balance, and blocks of groups of rows
block_sums      sums over such rows, here or by a cluster's workers
repeats         rows by the group that they repeat, a block of groups after the other
moments         repeats put together, pooled over loads and signs, and sums over shapes
rounding_steps  forces in steps, and the noise that these add
row_readers     the second reading of the rows, and fingerprints of some rows
"""
