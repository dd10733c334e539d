"""A stiffness regressed from shapes, its noise known: states whose residuals are all independent.

K_c = S_cz S_zz^-1 has noise of covariance N_c for rows, S_zz^-1 for columns. States V with
V'S_zz^-1 V = 1 and W'N W diagonal, N = D_alpha N_c D_alpha, both apart from rigid motions in these
metrics, have independent residuals; so the sums below are the likelihood itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.errors import RankDeficient
from truenewton.estimation.reciprocity.sight import Places, Sight
from truenewton.estimation.reciprocity.states import States, Weights, equal_bins
from truenewton.estimation.reciprocity.unknowns import Values

BINS = 12  # of states; up to `ONE_EACH` states one each
ONE_EACH = 100


@dataclass(frozen=True, eq=False)
class Regressed:
    """A stiffness by regression of forces on readings.

    Attributes
    ----------
    stiffness
        (n, n) K_c, commanded force per reading [N/m].
    square
        (n, n) S_zz, sum of z z' [m^2].
    noise
        (n, n) N_c, covariance of the force that a row of weight 1 leaves [N^2].
    noise_freedom
        Degrees of freedom from which the noise is known.
    bias_gradient
        Change of the bias magnets' force per displacement [N/m].
    coil_force
        (n,) COILGRAD times the mean force [N/m]: what K_c lacks at gain g is this times g - 1.
    """

    stiffness: Array
    square: Array
    noise: Array
    noise_freedom: float = np.inf
    bias_gradient: float = 0.0
    coil_force: Array | float = 0.0

    def at(self, values: Values) -> Array:
        """Return (n, n) D_alpha K_c, what magnets and coils change with the gap taken out [N/m]."""
        gain = values.gain
        true = values.alpha[:, None] * self.stiffness
        change = values.alpha * self.coil_force * (gain - 1.0) + self.bias_gradient * gain
        true[np.diag_indices(len(gain))] += change
        return np.asarray(true)

    def states(self, places: Places, values: Values, seen: Sight) -> tuple[States, Weights]:
        """Return the states, stiffest first, and the weights of their residuals."""
        n, true = places.n, self.at(values)
        noise = values.alpha[:, None] * self.noise * values.alpha
        try:
            root = np.linalg.cholesky(self.square)
        except np.linalg.LinAlgError:
            raise RankDeficient(
                "the positions of too few shapes that balance differ",
                remedy="see the warnings of ml for what does not balance, or add shapes",
            ) from None
        basis, triangle = np.linalg.qr(
            scipy.linalg.solve_triangular(root, places.rigid_readings(values), lower=True),
            mode="complete",
        )
        turn = np.linalg.inv(triangle[:3])
        rigid_readings, readings = root @ basis[:, :3], root @ basis[:, 3:]
        rigid = places.rigid
        rigid = rigid @ np.linalg.inv(np.linalg.cholesky(rigid.T @ noise @ rigid)).T
        moved = seen.motion @ (values.gain[:, None] * readings)
        moved -= rigid @ (rigid.T @ (noise @ moved))
        size, turned = np.linalg.eigh(moved.T @ noise @ moved)
        readings, moved = readings @ turned, moved @ turned
        states = States(
            readings=readings,
            forces=true @ readings,
            displacements=moved,
            rigid_readings=rigid_readings,
            rigid_forces=true @ rigid_readings,
            turn=turn,
            rigid=rigid,
            displaced=noise @ moved / size,
            balancing=noise @ rigid,
            dual=scipy.linalg.cho_solve((root, True), readings),
        )
        bins = equal_bins(n - 3, n - 3 if n <= ONE_EACH else BINS)
        of_bin = np.array([np.exp(np.mean(np.log(size[some]))) for some in bins])
        weights = Weights(
            statics=np.ones((3, n - 3)),
            rigid=np.repeat(1.0 / size[:, None], 3, axis=1),
            reciprocity=1.0 / (of_bin[:, None] + of_bin),
            bins=bins,
            share=size[:, None] / (size[:, None] + size),
            exact=1.0 / (size[:, None] + size),
        )
        return states, weights
