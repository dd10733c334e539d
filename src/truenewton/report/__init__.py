"""The report: what a campaign gave, and what it rests on.

investigate  from data to findings
findings     the calibration, or why there is none, and the evidence for it
evidence     residuals, balance before and after, singular values
change       what changed between two calibrations
verdict      the verdict with three numbers, and what to do
layers       what is known of each actuator, one layer a quantity
figures      figures of the evidence, for papers and the page
page/        the same on one page that opens without network
"""

import truenewton.report.figures  # noqa: F401  # registers the figures of findings
