"""The known mirrors, mirrors from files, and the shell between the actuators.

known         P45, LBT672, MMT336, ...: numbers with their standing
segmented     mirrors of several segments, those that are known among them
glass         glass and sensors: dimensions, outline and material
file          mirrors that someone else has: TOML and a table
checks        what a glass must be, beside its actuators, tool and weight
tables        where actuators stand, points of an outline
sensor_model  what the sensors of measured data see of the glass
shell/        the elastic shell: what forces hold it, and how it moves
"""

from truenewton.mirrors.known import Mirror, lbt672, mag585, mirror, mmt336, p45, ring

__all__ = ["Mirror", "lbt672", "mag585", "mirror", "mmt336", "p45", "ring"]
