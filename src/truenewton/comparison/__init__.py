"""What changed between two measured stiffness matrices of one mirror.

- `pairing`: both matrices for the same actuators in the same order.
- `fit`: factors of rows and columns, with errors.
- `compare`: which factors changed, and whether the errors are valid.
"""
