"""What becomes of alpha, and what is said, when a bench or a file does what the model does not.

    python -m studies.faults [--seeds 24] [--noise 1e-3 5e-5] [--only NAME ...] [--cycles 4]
    python -m studies.faults --only clean --seeds 1000      how often a word is false
    python -m studies.faults --mirror 336 --cycles 2        336 actuators on rings
    python -m studies.faults --method ml auto glass         methods on the same campaigns
    python -m studies.faults --list

The bench (`faulty`) is this benchmark's own. Alpha, noise and where a fault strikes differ from
seed to seed. The weights are declared without error, so that what is stated is what the readings
and their effects leave; two loads hide any error of the weights. Alpha is judged against the true
one, the mean over the campaign where it changes; actuators that a fault disables are not judged.
Columns: RMS error of alpha over actuators and seeds; that of the common scale, the mean over
actuators; the stated error; how many 95 % intervals hold the truth; in how many seeds there is no
alpha; the median probability of chi2, and in how many seeds it is below 1e-3; the share of rows
left out; in how many seeds anything was said, in how many the right cause, in how many that was
corrected (the right file or actuators with it); a verdict, and what is said first in most seeds:

    covered   90 % of the intervals or more hold the truth
    said      they do not, but the right cause is named in 95 % of the seeds or more
    refused   no alpha is given in 95 % of the seeds or more, whatever the reason
    budget    nobody can see it in such data: the page and the budget say what it costs
    SILENT    nothing of that, and in most seeds not a word
    WRONG     nothing of that, and other words
    FALSE     nothing is wrong, and something was said in 1 % of the seeds or more

Several methods have a line each, with the seeds in which the answer is by reciprocity / those in
which the verdict is sound; 'glass' is 'auto' with what the sensors see of the mirror, as of
`calibrate --mirror`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


from studies.faulty import files, forces, gains, readings
from studies.faulty.fault import FAULTS

# In the order of the modules that list them.
SECTIONS = [module.__name__ for module in (gains, readings, forces, files)]
ALL = sorted(FAULTS, key=lambda fault: SECTIONS.index(fault.happens.__module__))

METHODS = ("ml", "svd", "reciprocity", "auto", "glass")
TWO_SIGMA = 1.959964
COVERED, SAID, FALSE = 0.90, 0.95, 0.01
IMPROBABLE = 1e-3  # of a fit
