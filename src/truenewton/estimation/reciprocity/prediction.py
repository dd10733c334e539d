"""What reciprocity will state of a campaign, before a reading is taken.

The information is that of a fit, at the truth instead of at the minimum; the mean forces under the
loads go through the likelihood of `ml`, as they do in a fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.estimation.likelihood.objective import expected
from truenewton.estimation.prediction import Prediction, known_beforehand, repeated, stated
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.reciprocity.campaign import alpha_information, mean_forces
from truenewton.estimation.reciprocity.information import information
from truenewton.estimation.reciprocity.iteration import point_at
from truenewton.estimation.reciprocity.regression import Regressed, refuse_unheld
from truenewton.estimation.reciprocity.sensor_model import Places
from truenewton.estimation.reciprocity.unknowns import Kind, Request, at_nominal
from truenewton.records.campaign import Campaign


@dataclass(frozen=True, eq=False)
class Informed:
    """What one cycle of the shapes says.

    Attributes
    ----------
    asked
        What is asked of it.
    data
        (u, u) information on the unknowns, relative alpha first; proportional to the cycles.
    """

    asked: Request
    data: Array

    def after(self, cycles: int) -> Array:
        """Return (u, u) the information that so many cycles leave, what is known before added."""
        n = len(self.data) // len(self.asked.kinds)
        return np.asarray(cycles * self.data + np.diag(self.asked.information(n)))


def informed(
    places: Places,
    asked: Request,
    shapes: Array,
    force: Array,
    *,
    force_noise: float,
    position_noise: float,
) -> Informed:
    """Return what noiseless forces and readings will say of relative alpha and of the sensors.

    Parameters
    ----------
    places
        Of the n enabled actuators, with what their sensors see.
    asked
        Of the sensors.
    shapes, force
        (N, n) readings [m] and commanded forces [N] of one cycle under all loads, in excess of what
        each load takes: of every shape with both signs, so that their means are 0.
    force_noise, position_noise
        Standard deviations of one reading [N], [m].

    Raises
    ------
    RankDeficient
        Motions of the mirror that no shape holds.
    """
    square = shapes.T @ shapes
    refuse_unheld(square)
    stiffness = np.asarray(np.linalg.solve(square, shapes.T @ force).T)
    noise = force_noise**2 * np.eye(places.n) + position_noise**2 * stiffness @ stiffness.T
    states = Regressed(stiffness, square, np.asarray(noise)).states
    point = point_at(places, at_nominal(places.n), asked, states)
    return Informed(asked, information(point)[0])


def predict(
    campaign: Campaign, moments: Moments, said: Informed, cycles: int, alpha: Array
) -> Prediction:
    """Predict the errors of alpha by reciprocity, as `prediction.predict` does those of `ml`.

    Parameters
    ----------
    campaign, moments, cycles, alpha
        As there.
    said
        What `informed` says of the same shapes.

    Raises
    ------
    RankDeficient
    """
    known = known_beforehand(campaign, moments, alpha)
    problem = known.problem
    of_loads = mean_forces(problem, moments)
    data = replace(of_loads, sums=repeated(of_loads.sums, cycles))
    relative = alpha_information(said.after(cycles), said.asked) / np.outer(alpha, alpha)
    minimum = expected(problem.a, [data], problem.prior.with_more(relative), known.values)
    return stated(known, minimum)


def sensor_errors(said: Informed, cycles: int) -> dict[Kind, Array]:
    """Return the (n,) errors of log gains and of offsets [m], of those that are asked for."""
    whole, kinds = said.after(cycles), said.asked.kinds
    n = len(whole) // len(kinds)
    whole[:n, :n] += np.trace(whole[:n, :n]) / n**2  # relative alpha alone
    unit = 1.0 / np.sqrt(np.diag(whole))
    inverse = scipy.linalg.inv(unit[:, None] * whole * unit, check_finite=False)
    errors = np.split(unit * np.sqrt(np.diag(inverse)), len(kinds))
    return dict(zip(kinds[1:], errors[1:], strict=True))
