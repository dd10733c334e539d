"""What changed between two states of one mirror: matrices, campaigns or calibrations.

pairing  both matrices for the same actuators in the same order
fit      factors of rows and columns, the law of the noise, couplings that changed
compare  which factors changed, and whether the errors are valid
result   the result for matrices and campaigns, and its file
calibrations  what changed between two calibrations
summary  text for the terminal, values for JSON
"""

import truenewton.comparison.summary  # noqa: F401  # registers what its results can do
