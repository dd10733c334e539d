"""The simulated bench, which keeps its truth to itself.

bench        the bench, as acquisition sees any other
static       a mirror's truth and its campaigns, every shape held exactly or in a loop
segmented    a bench for each segment of a mirror, moved together
loop         the closed loop: sample to sample, its stability, means over a record
electronics  sensors, control, coils and magnets of the actuators
truth        what a simulation knows; written beside the campaign, for scoring only
"""
