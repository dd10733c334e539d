"""All methods through one door."""

from truenewton.estimators.calibrate import METHODS, calibrate

__all__ = ["METHODS", "calibrate"]
