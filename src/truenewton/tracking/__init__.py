"""Time, temperature and replaced parts."""

from truenewton.tracking.family import Family
from truenewton.tracking.law import Departure, Prediction, Tracking
from truenewton.tracking.recalibration import Recalibration, recalibrate
from truenewton.tracking.track import track
from truenewton.tracking.track_files import read_tracking
from truenewton.tracking.validity import Validity

__all__ = [
    "Departure",
    "Family",
    "Prediction",
    "Recalibration",
    "Tracking",
    "Validity",
    "read_tracking",
    "recalibrate",
    "track",
]
