"""Reading patterns of the mirror, and the forces and displacements that go with them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array


@dataclass(frozen=True, eq=False)
class States:
    """States of the mirror at given unknowns, and the rigid motions beside them.

    W, Q span the displacements at the magnets and X, Y the forces, in duality: W'X = 1, Q'Y = 1,
    W'Y = Q'X = 0. So do the readings V, z_R with ``dual``: V'dual = 1, z_R'dual = 0.

    Attributes
    ----------
    readings, forces, displacements
        (n, m) V as the sensors read them, F = D_alpha K_c V true, W = H D_g V but for rigid
        motions.
    rigid_readings, rigid_forces
        (n, 3) z_R, and D_alpha K_c z_R, which is nothing but for errors.
    turn
        (3, 3) of the rigid readings: z_R = D_g^-1 [nz, (x - dx)/L, (y - dy)/L] turn.
    rigid
        (n, 3) Q, rigid motions of the magnets.
    displaced, balancing
        (n, m) X and (n, 3) Y.
    dual
        (n, m) of the readings.
    """

    readings: Array
    forces: Array
    displacements: Array
    rigid_readings: Array
    rigid_forces: Array
    turn: Array
    rigid: Array
    displaced: Array
    balancing: Array
    dual: Array

    @property
    def count(self) -> int:
        """Number of states."""
        return int(self.readings.shape[1])


@dataclass(frozen=True, eq=False)
class Weights:
    """Of the equations: 1 over the variance of each residual.

    Attributes
    ----------
    statics
        (3, m) of S = Q'F.
    rigid
        (m, 3) of t = W'D_alpha K_c z_R.
    reciprocity
        (b, b) of A = T - T', T = W'F, by bins of states.
    bins
        The slices of states that are alike.
    share
        (m, m) variance of T over that of A: of the difference between T and T', how much the first
        takes up; None for one half.
    exact
        (m, m) weights of A, where these are known state by state.
    """

    statics: Array
    rigid: Array
    reciprocity: Array
    bins: tuple[slice, ...]
    share: Array | None = None
    exact: Array | None = None

    def every(self, some: slice) -> Weights:
        """Return those of some of the states, in the same bins."""
        kept = np.arange(self.statics.shape[1])[some]
        edges = np.searchsorted(kept, [0, *(each.stop for each in self.bins)]).tolist()
        return replace(
            self,
            statics=self.statics[:, some],
            rigid=self.rigid[some],
            bins=tuple(slice(*pair) for pair in itertools.pairwise(edges)),
            share=None if self.share is None else self.share[some, some],
            exact=None if self.exact is None else self.exact[some, some],
        )

    @property
    def of_balance(self) -> Weights:
        """Those of statics, nothing else counting."""
        return replace(self, rigid=0.0 * self.rigid, reciprocity=0.0 * self.reciprocity)

    @property
    def of_symmetry(self) -> Weights:
        """Those of rigid motions and reciprocity, statics not counting."""
        return replace(self, statics=0.0 * self.statics)

    @property
    def of_pairs(self) -> Array:
        """(m, m) weights of A."""
        if self.exact is not None:
            return self.exact
        sizes = [some.stop - some.start for some in self.bins]
        return np.asarray(np.repeat(np.repeat(self.reciprocity, sizes, axis=0), sizes, axis=1))


def equal_bins(count: int, bins: int) -> tuple[slice, ...]:
    """Return slices that part so many states into bins of equal number, as nearly as can be."""
    edges = np.linspace(0, count, max(1, min(bins, count)) + 1).round().astype(int)
    return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges))
