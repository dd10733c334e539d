"""The result of a calibration, and the door to every method.

methods     the door: data and a method in, a calibration out
result      the calibration: alpha, errors, covariance; and its file (docs/files.md)
numbers     the numbers of an estimate spread over all actuators, but for excluded ones
workers     segments side by side, in processes of their own
export      a calibration as a file, in the form that its name ends in
figures     alpha with errors (paper, fig. 5), and all figures of a calibration as files
verdict     sound, usable, doubtful or rejected; what is wrong with the common scale
summary     a calibration in words and numbers: terminal, page, script
survey      what data hold, before anything is calibrated
"""

import truenewton.calibration.export  # noqa: F401  # registers what its results can do
