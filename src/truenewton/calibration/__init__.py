"""The result of a calibration, and the function that makes it.

methods  from data to a calibration: the method, and its numbers for all actuators
result   the calibration: alpha, errors, covariance; and the columns of its file
layers   the quantities of each actuator, for maps and tables
file     a calibration in files: FITS (written by `records.result`), its table, or alpha alone
figures  alpha with errors (paper, fig. 5), and all figures of a calibration as files
verdict  sound, usable, doubtful or rejected; faults of the common scale
summary  text and numbers of a calibration: terminal, report, JSON
survey   the contents of data, and whether alpha can be determined from them
"""

import truenewton.calibration.file  # noqa: F401  # registers what its results can do
