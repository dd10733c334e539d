"""After an actuator, a magnet or a coil was replaced: a short run beside the earlier calibration.

known      what the earlier calibration knows, and which errors a new run shares
short_run  the likelihood of the short run, its bad rows, who has moved
fit        the recalibration itself, and its result
summary    in words and numbers: terminal, script
"""
