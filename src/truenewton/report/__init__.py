"""The report: a calibration, and the evidence for it.

findings  `investigate`: a calibration, its evidence and modal basis, or why there is none
verdict   the verdict with three numbers, and advice
figures   figures of the evidence, for papers and the page
page/     all on one page that opens without network
"""

import truenewton.report.figures  # noqa: F401  # registers the figures of findings
