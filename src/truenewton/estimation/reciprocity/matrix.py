"""Reciprocity of a stiffness matrix alone: relative alpha, sensors, and held-out modes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import Estimate
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.matrix.columns import SETTLED_STEP
from truenewton.estimation.matrix.facts import MIN_MEASURED_DEVIATION, ElasticModes, MatrixFacts
from truenewton.estimation.matrix.misfits import condensed
from truenewton.estimation.matrix.modes import EVEN_MODES, ODD_MODES, Imbalance, imbalances_of
from truenewton.estimation.matrix.order import balance_effects
from truenewton.estimation.matrix.screen import ScreenedMatrix
from truenewton.estimation.reciprocity import acceptance
from truenewton.estimation.reciprocity.information import Leverage, States, Weights
from truenewton.estimation.reciprocity.iteration import Fit, fit, in_double
from truenewton.estimation.reciprocity.noise import (
    BinnedNoise,
    MatrixNoise,
    beyond_noise,
    drawn_differences,
    noise_of,
    stated_errors,
)
from truenewton.estimation.reciprocity.regression import kept, kept_places
from truenewton.estimation.reciprocity.sensor_model import (
    START_REQUEST,
    Kind,
    Places,
    Request,
    Values,
    places_of,
)
from truenewton.progress import report_progress
from truenewton.statics.layout import Layout

# Error of alpha of simulated mirrors of 45 to 100 actuators if annular sensors are taken as points;
# with 336 actuators it is 0.0012 (`python -m studies.matrices --annular`).
POINT_SENSORS_ERROR = 0.003
AT_MAGNETS_OFFSET = 5e-5  # rms offset [m] up to which the plate model is accurate enough


@dataclass(frozen=True, eq=False)
class Modes:
    """The elastic modes of a measured stiffness K_c = U S V', stiffest first."""

    places: Places  # of the actuators
    arms: Array  # (3, n), lengths in units of the rms distance from the axis
    stiffness: Array  # (n, n) K_c, with its softest modes [N/m]
    elastic: ElasticModes  # the modes that are used

    def every(self, some: slice) -> Modes:
        """Return some of the modes."""
        return replace(self, elastic=self.elastic.every(some))

    def imbalances(self, *fits: Fit) -> tuple[Imbalance, ...]:
        """Return the imbalance with alpha of fits to all, to even and to odd modes."""
        alphas = (each.values.alpha for each in fits)
        return imbalances_of(self.elastic.forces, self.arms, *alphas)

    def fit(
        self,
        asked: Request,
        *,
        balance: bool = False,
        start: Values | None = None,
        weights: Weights | None = None,
        leverage: Leverage | None = None,
        until: float = SETTLED_STEP,
    ) -> Fit:
        """Fit alpha and sensors by balance and reciprocity, or by balance alone.

        Unless weights are given, they are estimated as well, first with the given ``leverage``.
        ``until`` as of `iteration.fit`.
        """
        noise = BinnedNoise(self.elastic.stiffness, self.elastic.readings, balance, leverage)
        if weights is None:
            return fit(self.places, asked, noise, start=start, told=noise.told, until=until)

        def weighted(*at: Any) -> tuple[States, Weights]:
            return noise.states(*at), weights

        return fit(self.places, asked, weighted, start=start, fixed=True)


def modes_of(
    layout: Layout,
    facts: MatrixFacts,
    motion: Array | None = None,
    keep: NDArray[np.bool_] | None = None,
) -> Modes:
    """Return the elastic modes of a matrix of commanded force per reading.

    ``motion`` is the (n, n) or (6, n, n) sensor model of the shell (`places_of`), ``keep`` marks
    the (n,) actuators that count; the others are free.
    """
    places = places_of(layout, motion)
    if keep is not None and not keep.all():
        places = kept_places(places, keep, facts.stiffness)
        facts = MatrixFacts(condensed(facts.stiffness, keep)[0], facts.arms[:, keep])
    return Modes(places, facts.arms, facts.stiffness, facts.elastic_modes)


@dataclass(frozen=True, eq=False)
class MatrixEvidence:
    """Fits of a stiffness, and how they agree."""

    joint: Fit  # by all equations
    imbalances: tuple[Imbalance, ...]  # of all modes, and of held-out ones
    halves: tuple[Array, Array]  # (n,) log alpha of fits to every second mode
    covariance: Array  # (n, n) of log alpha of the joint fit
    sensor_errors: dict[Kind, Array]  # (n,) of log g and of offsets [m]
    # (n,) log alpha by balance alone and by reciprocity alone; NaN if there is none
    alone: tuple[Array, Array]
    evidence: acceptance.Evidence


@dataclass(frozen=True, eq=False)
class RoughFit:
    """A fit of all modes that is nearly settled, without its large matrices."""

    asked: Request  # with the spreads so far
    values: Values
    leverage: Leverage | None
    error: float  # typical error of log alpha by noise


def fit_roughly(modes: Modes) -> RoughFit:
    """Fit all modes by balance and reciprocity until nearly settled, and judge it by its noise.

    Raises RankDeficient, NotConverged.
    """
    report_progress("reciprocity", 0.02)
    fitted = modes.fit(START_REQUEST, until=0.3)  # of the error of alpha
    report_progress("reciprocity, the noise", 0.3)
    noise = noise_of(modes.stiffness, fitted, modes.places, rough=True)
    error = float(np.median(np.sqrt(np.diag(stated_errors(fitted, noise)[0]))))
    return RoughFit(fitted.asked, fitted.values, fitted.leverage, error)


def fit_jointly(modes: Modes, rough: RoughFit) -> tuple[Fit, MatrixNoise]:
    """Return the settled fit of all modes, and the noise of the matrix.

    The covariance is in single precision. Raises RankDeficient, NotConverged.
    """
    report_progress("reciprocity", 0.4)
    joint = modes.fit(rough.asked, start=rough.values, leverage=rough.leverage)
    return joint, noise_of(modes.stiffness, joint, modes.places)


def examined(modes: Modes, joint: Fit, noise: MatrixNoise) -> MatrixEvidence:
    """Fit every second mode by all equations, and all by balance alone and reciprocity alone.

    Noise and scatter of the sensors are those of the fit to all, except by balance alone.
    Raises RankDeficient, NotConverged.
    """
    joint = in_double(joint)
    covariance, of_sensors = stated_errors(joint, noise)
    joint = joint.of_alpha  # the rest of its memory is needed
    doubtful = modes.places.changes is None and joint.asked.offset_spread > AT_MAGNETS_OFFSET
    report_progress("reciprocity, of halves of the modes", 0.65)
    again, weights = replace(joint.asked, estimated=False), joint.point.weights
    halves = [
        modes.every(some).fit(again, start=joint.values, weights=weights.every(some)).of_alpha
        for some in (EVEN_MODES, ODD_MODES)
    ]
    imbalances = modes.imbalances(joint, *halves)
    drawn = drawn_differences(halves, noise)
    excess = beyond_noise(halves, drawn, alike=True, doubtful=doubtful)
    of_halves = acceptance.disagreement(*halves)
    one, other = (half.values for half in halves)
    del halves, drawn
    report_progress("reciprocity, against the balance", 0.8)
    try:
        evidence, ways, unequal = _against_balance(
            modes, joint, noise, of_halves, doubtful=doubtful
        )
    except (RankDeficient, NotConverged):
        # If balance alone gives no alpha, nothing contradicts reciprocity.
        evidence, unequal = acceptance.Evidence(), 1.0
        ways = (np.full(modes.places.n, np.nan),) * 2
    evidence = replace(
        evidence,
        held_out=_held_out(imbalances),
        gain_spread=joint.asked.gain_spread,
        offset_spread=joint.asked.offset_spread,
    )
    excess = max(excess, unequal)
    if doubtful or excess > 1.0:
        # Model errors are no smaller in the fit to all modes than in one half.
        of_alpha = np.var(one.log_alpha - other.log_alpha) / np.mean(np.diag(covariance))
        covariance = covariance * max(excess, 0.5 * float(of_alpha))
        for kind, error in of_sensors.items():
            rms = np.sqrt(0.5 * np.mean((one.of(kind) - other.of(kind)) ** 2))
            of_sensors[kind] = np.maximum(error, error * rms / np.sqrt(np.mean(error**2)))
    return MatrixEvidence(
        joint, imbalances, (one.log_alpha, other.log_alpha), covariance, of_sensors, ways, evidence
    )


def _against_balance(
    modes: Modes, joint: Fit, noise: MatrixNoise, of_halves: float, *, doubtful: bool
) -> tuple[acceptance.Evidence, tuple[Array, Array], float]:
    """Fit balance alone and reciprocity alone.

    Returns how they agree, (n,) log alpha by each, and the variance between them over that of
    noise. ``of_halves`` is the disagreement of the halves.
    """
    balance, *halves = [  # alpha only: the balance knows nothing of sensors
        in_double(each.fit(Request(), balance=True, start=joint.values))
        for each in (modes, modes.every(EVEN_MODES), modes.every(ODD_MODES))
    ]
    by_balance = _held_out(modes.imbalances(balance, *halves))
    own = acceptance.disagreement(*halves)
    del halves
    weights = joint.point.weights.of_symmetry
    again = replace(joint.asked, estimated=False)
    reciprocity = modes.fit(again, start=joint.values, weights=weights)
    pair = (balance, reciprocity.of_alpha)
    drawn = drawn_differences(pair, noise)
    excess = beyond_noise(pair, drawn, alike=False, doubtful=doubtful)
    between = as_stated = acceptance.apart(*pair, own, of_halves)
    if noise.variance is not None:  # what the fits state is not their error
        between = beyond_noise(pair, drawn, alike=False, doubtful=True)
    ways = (pair[0].values.log_alpha, pair[1].values.log_alpha)
    return (
        acceptance.Evidence(by_balance=by_balance, apart=between, as_stated=as_stated),
        ways,
        excess,
    )


def _held_out(imbalances: tuple[Imbalance, ...]) -> float:
    """Return the imbalance of held-out modes, over both halves."""
    return float(np.linalg.norm([line.after for line in imbalances[1:]]))


def fit_matrix(
    screened: ScreenedMatrix,
    base: Estimate,
    motion: Array | None = None,
    *,
    where_it_holds: bool = False,
) -> tuple[Estimate, tuple[Imbalance, ...], tuple[Finding, ...]]:
    """Return relative alpha and the sensors, the imbalances, and what contradicts the result.

    The stated error is that of noise (`noise`), enlarged if halves of the modes, or balance and
    reciprocity, differ by more: the residuals of a real matrix are not all noise. If sensors are
    off their magnets and the shell is not known, it is at least that of one half.

    ``base`` is the estimate of `ml`, with the findings about the matrix itself. ``motion`` is
    (n, n) as for `modes_of`. ``where_it_holds``: return ``base`` if too many actuators are odd, or
    if noise alone makes the errors larger.
    Raises RankDeficient, NotConverged.
    """
    layout, facts = screened.matrix.layout, screened.facts
    for effect in balance_effects(facts):
        raise RankDeficient(effect.name, remedy=effect.remedy)
    if facts.asymmetry < MIN_MEASURED_DEVIATION:
        raise RankDeficient(
            "STIFFNESS is symmetric as commanded, so reciprocity gives alpha = 1 whatever it is",
            remedy="use the matrix as it was measured",
        )
    keep, odd = kept(facts.stiffness, facts.pair_ratios[0])
    transposed = facts.looks_transposed
    if odd and where_it_holds:
        return (
            base,
            (),
            tuple(acceptance.refusals(acceptance.Evidence(odd=odd, transposed=transposed))),
        )
    modes, n = modes_of(layout, facts, motion, keep), len(keep)
    rough = fit_roughly(modes)
    of_balance = float(np.median(_relative_errors(base, n)[keep]))
    if where_it_holds and acceptance.surely_worse(rough.error, of_balance):
        worse = acceptance.Evidence(error=rough.error, error_by_balance=of_balance)
        return base, (), tuple(acceptance.refusals(worse))
    found = examined(modes, *fit_jointly(modes, rough))
    joint = found.joint
    by_balance = base.values[:n]
    alpha = by_balance.copy()
    positive = by_balance[keep & (by_balance > 0.0)]  # some are, as their mean is 1
    scale = np.exp(np.mean(np.log(positive)))
    alpha[keep] = scale * joint.values.alpha
    alpha /= alpha.mean()
    whole = np.diag(np.diag(base.reading_covariance)[:n] / by_balance**2)
    whole[np.ix_(keep, keep)] = found.covariance
    held = np.eye(n) - np.outer(np.ones(n), alpha / alpha.sum())  # mean alpha stays 1
    covariance = held @ whole @ held.T * np.outer(alpha, alpha)
    ids = layout.id[layout.enabled]
    of_columns = Code.COLUMN_NOISE_NOT_INDEPENDENT
    said = [each for each in base.diagnosis.warnings if each.code is not of_columns]
    if not keep.all():
        said.append(Finding.of(Code.RECIPROCITY_EXCLUDED, actuators=ids[~keep]))
    estimate = replace(
        base,
        method="reciprocity",
        values=alpha,
        reading_covariance=covariance,
        diagnosis=replace(base.diagnosis, warnings=tuple(said)),
        sensors=acceptance.sensors_of(joint, found.sensor_errors, ids, keep),
    )
    stated = float(np.median(_relative_errors(estimate, n)[keep]))
    if motion is None and stated < POINT_SENSORS_ERROR:
        unmodelled = Finding.of(Code.GLASS_NOT_MODELLED, model=POINT_SENSORS_ERROR, error=stated)
        estimate = estimate.with_warnings((unmodelled,))
    evidence = replace(
        found.evidence,
        odd=odd,
        transposed=transposed,
        error=stated,
        error_by_balance=of_balance,
    )
    return estimate, found.imbalances, tuple(acceptance.refusals(evidence))


def _relative_errors(estimate: Estimate, n: int) -> Array:
    """Return (n,) E_STAT relative to alpha."""
    return np.asarray(np.sqrt(np.diag(estimate.reading_covariance)[:n]) / estimate.values[:n])
