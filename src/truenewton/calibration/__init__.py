"""The result of a calibration, and the door to every method.

methods        the door: data and a method in, a calibration out
result         the calibration: alpha, errors, covariance, and how they came about
exclusion      actuators whose alpha is not wanted
numbers        the numbers of an estimate where a calibration keeps them
workers        segments side by side, in processes of their own
file           the calibration file (docs/files.md)
export         a calibration as a file, in the form that its name ends in
figures        alpha with errors (paper, fig. 5), and all figures of a calibration as files
scale_faults   what is wrong with the common scale: unit, weights, their errors
verdict        sound, usable, doubtful or rejected: one verdict for all who ask
summary        a calibration in words and numbers: terminal, page, script
survey         what data hold, before anything is calibrated
"""

import truenewton.calibration.export  # noqa: F401  # several segments are kept as it says
