"""Comparisons of simulated truth and estimate.

Only this package, `planning` and the command line import both simulation and analysis.

proof    the paper's proof code (sec. 4): without noise, the systems return alpha
scoring  a calibration of simulated data compared with the truth, in numbers and text
"""
