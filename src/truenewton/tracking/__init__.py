"""How alpha varies with time and temperature, from calibrations of different days.

days        the calibrations, gathered, checked, put in order
linear_fit  the line of every actuator through its days, each alone
scatter     from day to day: of each actuator, and of all in common
outlying_day  that lies off the law of the others
family      one physics, each actuator its own deviation
fit         from days to the law
law         the result: alpha at any temperature and time
validity    when to calibrate again
file        the tracking file (docs/files.md)
figures     alpha against temperature and time; the family
summary     in words and numbers: terminal, script
"""

import truenewton.tracking.file  # noqa: F401  # several segments are kept as it says
