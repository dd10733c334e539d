"""A short run after actuators were replaced, with an earlier calibration as prior.

prior    the earlier calibration, the likelihood of the run with it, and actuators that moved
fit      `recalibrate` and its result
summary  text for the terminal, values for JSON
"""
