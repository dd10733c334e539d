"""A bench on which things go wrong, for `faults.py`.

bench      the bench of one seed: what happens, and what the files say of it
fault      what a fault is, and the list of all
gains      nothing, and coils whose gain is not what it was
readings   zeros and noise
forces     what touches the glass, and what is heavier than it is said to be
files      places, cables and labels
"""
