"""How alpha varies with time and temperature, from calibrations of different days.

days        the calibrations, gathered, checked, put in order
linear_fit  the line of every actuator through its days, each alone
scatter     from day to day: of each actuator, of all in common, and days that lie off the law
family      one physics, each actuator its own deviation
fit         from days to the law
law         the result: alpha at any temperature and time, its file, and when to calibrate again
figures     alpha against temperature and time; the family
summary     in words and numbers: terminal, script
"""

import truenewton.tracking.summary  # noqa: F401  # registers what its results can do
