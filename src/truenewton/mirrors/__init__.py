"""The known mirrors, mirrors from files, and the shell between the actuators.

known         P45, LBT672, MMT336, ...: numbers with their standing
segmented     mirrors of several segments, the known ones included
glass         glass and sensors: dimensions, outline and material
file          mirrors from TOML, and their tables of actuators and outlines
checks        what the glass of a mirror, its actuators, tool and weight must be
sensor_model  what the sensors of measured data see of the glass
shell/        the elastic shell: what forces hold it, and how it moves
"""

from truenewton.mirrors.known import Mirror, lbt672, mag585, mirror, mmt336, p45, ring

__all__ = ["Mirror", "lbt672", "mag585", "mirror", "mmt336", "p45", "ring"]
