"""All methods through one door."""

from truenewton.estimators.calibrate import METHODS, calibrate, held_out

__all__ = ["METHODS", "calibrate", "held_out"]
