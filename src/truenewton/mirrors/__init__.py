"""Known mirrors, mirrors from files, and the shell between the actuators.

known         P45, LBT672, MMT336, ...: numbers with their standing
segmented     mirrors of several segments, the known ones included
glass         glass and sensors: dimensions, outline and material
file          mirrors from TOML, tables of actuators and outlines, and checks of these
sensor_model  what the sensors of measured data read, by the model of the glass
shell/        the elastic shell: the forces that hold it, and its dynamics
"""

from truenewton.mirrors.known import Mirror, lbt672, mag585, mirror, mmt336, p45, ring

__all__ = ["Mirror", "lbt672", "mag585", "mirror", "mmt336", "p45", "ring"]
