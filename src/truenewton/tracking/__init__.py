"""Alpha against temperature and time, from calibrations of several days.

days        reads the calibrations, checks them, and puts them in order
lines       a line for each actuator through its days; scatter; days that are outliers
population  the common distribution of the coefficients, and actuators that are outliers
fit         `track`: from days to the law
law         the result and its file; alpha at any temperature and time; when to calibrate again
figures     alpha against temperature and time; the coefficients and their population
summary     text for the terminal, values for JSON
"""

import truenewton.tracking.summary  # noqa: F401  # registers what its results can do
