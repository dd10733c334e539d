"""What changed between two stiffness matrices, or two calibrations, of one mirror.

pairing  both matrices for the same actuators in the same order
fit      factors of rows and columns, the law of the noise, couplings that changed
compare  which factors changed, and whether the errors are valid
calibrations  what changed between two calibrations
summary  text for the terminal, values for JSON
"""
