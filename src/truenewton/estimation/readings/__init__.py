"""From rows to means, in two readings of the files.

rows            rows of a cycle as they balance, and the groups of rows that repeat one shape
repeats         sums over the rows of each group, one block of groups after the other
moments         number, mean and scatter of repeats, pooled rows, and sums over shapes
rounding_steps  steps of the readings, and the noise that they add
row_readers     the second reading of the rows, and fingerprints of some rows
"""
