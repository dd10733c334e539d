"""What must see the truth and the estimate; sees both towers.

proof    the paper's proof code (sec. 4): without noise, alpha comes back
scoring  a calibration of simulated data beside the truth that made them
summary  both in words and numbers
"""
