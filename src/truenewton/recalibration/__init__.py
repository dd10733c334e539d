"""A short run after actuators were replaced, with an earlier calibration as prior.

prior      the earlier calibration, and errors of weights that the run shares with it
short_run  the likelihood of the run, its bad rows, and actuators that moved
fit        `recalibrate` and its result
summary    text for the terminal, values for JSON
"""
