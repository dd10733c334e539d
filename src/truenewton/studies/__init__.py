"""Comparisons of simulated truth and estimate; the only package that imports both sides.

proof    the paper's proof code (sec. 4): without noise, the systems return alpha
scoring  a calibration of simulated data compared with the truth, in numbers and text
"""
