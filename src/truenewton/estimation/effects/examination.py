"""A fit examined: which effects the data show, which were taken out, and what is left.

The likeliest effect is estimated together with alpha, then the catalogue tested again, four times
at most. It is accepted only if it cures: the balance of the shapes and their repetition over loads
and signs both fit after it. Of effects about as likely the one with the fewest parameters is taken.
Where nothing cures, nothing is taken out, and the errors grow by what does not fit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, chi2_cdf, chi2_sf, f_sf
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.effects.catalogue import LOAD_REPOSITIONED, ZEROS_OF_EACH
from truenewton.estimation.effects.correction import Correction, correction, with_error
from truenewton.estimation.effects.derivative import FittedRows
from truenewton.estimation.effects.score_test import (
    EffectTest,
    UnknownForce,
    beside_shared_noise,
    disturbed,
    named,
    unknown_force,
)
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import ErrorKind, ScaleError
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.noise import (
    MIN_FIT_PROBABILITY,
    Noise,
    Structure,
    structure_of,
)
from truenewton.records.campaign import Campaign, load_temperatures


@dataclass(frozen=True, eq=False)
class ExaminedFit:
    """What is left after effects were looked for.

    Attributes
    ----------
    problem, moments, minimum
        The data without the effects that were taken out, and their fit.
    effective_parameters
        How many of their parameters the balance had to tell.
    effects
        Those named, the likeliest first.
    structure
        How well shapes repeat over loads and signs; None where that was not asked.
    correlated
        Whether noise hangs together from row to row, so that shapes may balance too well.
    explained
        Whether what was named but not taken out would make it fit.
    """

    problem: Problem
    moments: Moments
    minimum: Minimum
    effective_parameters: float = 0.0
    effects: tuple[Finding, ...] = ()
    structure: Structure | None = None
    correlated: bool = False
    explained: bool = False

    @cached_property
    def rows(self) -> FittedRows:
        """The rows at the fit, whose readings are independent."""
        return FittedRows(self.problem, self.moments, self.minimum, independent=True)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the balance."""
        return self.problem.degrees_of_freedom(self.moments) - self.effective_parameters

    @property
    def probability(self) -> float:
        """Chance of a larger chi^2 of the balance."""
        return chi2_probability(self.minimum.chi2, self.freedom, self.problem.noise)

    @property
    def too_well(self) -> bool:
        """Whether the shapes balance better than their noise lets expect."""
        return self.freedom > 0 and self.probability > 1.0 - MIN_FIT_PROBABILITY

    @property
    def fits(self) -> bool:
        """Whether both the balance and the repetition of shapes fit."""
        repeated = self.structure is None or self.structure.probability > MIN_FIT_PROBABILITY
        return (
            self.probability > MIN_FIT_PROBABILITY
            and repeated
            and (self.correlated or not self.too_well)
        )

    @property
    def excess(self) -> float:
        """By how much the variance of what is left is larger than the noise says, if at all."""
        balance = self.minimum.chi2 / max(self.freedom, 1.0)
        return max(1.0, balance, self.structure.reduced if self.structure else 1.0)


def chi2_probability(chi2: float, freedom: float, noise: Noise) -> float:
    """Return how often chance makes chi^2 as large, the noise being known only so well."""
    if freedom <= 0:
        return 1.0
    if np.isinf(noise.share_freedom):
        return float(chi2_sf(chi2, freedom))
    return float(f_sf(chi2 / freedom, freedom, noise.share_freedom))


def misfit_findings(left: ExaminedFit) -> Iterator[Finding]:
    """Yield that the model does not fit, and by how much errors grew for it."""
    if left.fits:
        return
    if left.explained:
        yield Finding.of(Code.MISFIT_EXPLAINED)
    elif left.excess > 1.0:
        yield Finding.of(Code.MISFIT, factor=float(np.sqrt(left.excess)))
    elif left.too_well and left.structure is not None:
        yield Finding.of(Code.FIT_TOO_GOOD)


def warmer_loads(campaign: Campaign, scale_errors: Iterable[ScaleError]) -> Iterator[Finding]:
    """Name a temperature that differs between loads by more than the readings leave open."""
    relative = {line.source.kind: line.relative for line in scale_errors}
    if relative.get(ErrorKind.BETWEEN_LOADS, 0.0) <= relative.get(ErrorKind.READINGS, np.inf):
        return
    yield Finding(
        code=Code.TEMPERATURE_BETWEEN_LOADS,
        size=float(np.ptp(load_temperatures(campaign))),
        unit="K",
        remedy="keep the temperature, or take bare and loaded cycles in turn; if it was kept, check"
        " TEMPERATURE and its unit",
    )


MAX_EFFECTS = 4  # effects at once
MAX_UNKNOWN_FORCES = 2  # actuators at which forces come and go: three can make any imbalance
# Chi^2 over degrees of freedom that unknown forces, normal as they are not, may leave.
MAX_REDUCED_CHI2 = 2.0
MIN_SEEN_SPREAD = 0.5  # of tau^2: so much of a spread of zeros the data must show
# Of the logarithm of the smallest probability: effects about as likely.
SIMILAR_LOG_PROBABILITY = 0.85


def examined(
    problem: Problem,
    moments: Moments,
    minimum: Minimum,
    structure: Structure | None,
    samples: Sequence[Array],
) -> ExaminedFit:
    """Look for effects in data and their fit, and take out those that cure.

    Parameters
    ----------
    problem, moments, minimum
        The data, and their fit.
    structure
        How well shapes repeat over loads and signs; None where nothing tells.
    samples
        Deviations of some rows from their repeats, in parts of (m, n) [N].
    """
    plain = ExaminedFit(problem, moments, minimum)
    if structure is None:
        return plain
    # What files or hours do to all readings looks like noise that they share, until it is out.
    unshared = replace(problem.noise, share=1.0, share_freedom=np.inf)
    alone = replace(problem, noise=unshared, disturbance=0.0)
    if moments.pooled and not problem.dependent:
        start: ExaminedFit | None = replace(plain, structure=structure)  # fitted so already
    else:
        start = _pooled(alone, moments, minimum, structure)
    if start is None:
        return plain
    # Noise that is independent within a row but balances too well hangs together from row to row.
    start = replace(start, correlated=start.too_well and not problem.dependent)
    cured, named_first = _cured(start, independent=True, samples=samples, within=problem.dependent)
    if start.correlated and (cured is None or not cured.effects):
        return _correlated(start, named_first.effects)
    if cured is not None and (cured.effects or not problem.dependent):
        return cured
    if problem.dependent:
        start = replace(plain, structure=structure) if moments.pooled else plain
        before = named_first
        cured, named_first = _cured(start, independent=False, samples=samples)
        if cured is not None:
            return cured
        if start.too_well:  # even without what readings of a row share
            if before.effects:
                named_first = before
            slow = _correlated(start, named_first.effects)
            return replace(slow, minimum=_unsure(slow, named_first))
    best = plain if plain.fits and not start.fits else start
    if not named_first.effects or not named_first.fits:
        for one in (start, plain):
            forced = _with_unknown_forces(one)
            if forced is not None:
                return forced
    # What two readings of the data explain, alpha may be wrong by.
    return replace(
        best,
        effects=named_first.effects,
        minimum=_unsure(best, named_first),
        explained=bool(named_first.effects) and named_first.fits,
    )


def _pooled(
    problem: Problem, moments: Moments, minimum: Minimum, structure: Structure
) -> ExaminedFit | None:
    """Return the fit to pooled rows, whether shapes repeat so or not; None where there is none."""
    pooled = replace(moments, pooled=True)
    try:
        fitted = problem.fitted(pooled, minimum.values)
    except (NotConverged, RankDeficient):
        return None
    return ExaminedFit(problem, pooled, fitted, structure=structure)


def _cured(
    start: ExaminedFit, *, independent: bool, samples: Sequence[Array], within: bool = False
) -> tuple[ExaminedFit | None, ExaminedFit]:
    """Take out the likeliest effects until all fits; None where that fails.

    Also what came of the first effect named, where it could not be taken out. The first is one by
    which rows of one group differ, what they seemed to share, if ``within``.
    """
    now, first = start, start
    for _ in range(MAX_EFFECTS):
        fit = now.rows
        if not independent:
            fit = FittedRows(now.problem, now.moments, now.minimum, independent)
        found = named(fit)
        shared = within and not now.effects  # noise, or what such an effect does
        if shared:
            found = beside_shared_noise(found, fit, samples)
        if not found:
            return (now if now.fits else None), first
        if not first.effects:
            first = replace(start, effects=(_found(fit, found[0], None),))
        force = None if shared else unknown_force(fit)
        if force is not None and force.log_probability < found[0].log_probability:
            return _with_unknown_forces(now), first
        after = None
        for test in _alike(found):
            corrected = correction(fit, test.effect)
            if corrected is None:
                continue
            test, corrected = _as_mounting(fit, test, corrected)
            trial = _after(now, fit, test, corrected, samples)
            if trial.fits or after is None:
                after = trial
            if trial.fits:
                break
        if after is None:
            return None, first
        if after.fits and not after.effects[-1].corrected:
            return None, after
        if not now.effects:
            left_in = replace(after.effects[0], corrected=False)
            first = replace(after, effects=(left_in,))
        now = after
    return (now if now.fits else None), first


def _with_unknown_forces(now: ExaminedFit) -> ExaminedFit | None:
    """Let forces come and go at some actuators until none stands out; None if little fits then."""
    found: dict[int, UnknownForce] = {}
    for _ in range(4 * MAX_UNKNOWN_FORCES):  # four times for the size of each
        fit = FittedRows(now.problem, now.moments, now.minimum, independent=False)
        force = unknown_force(fit)
        if force is None:
            break
        before = found.get(force.index)
        if before is not None:
            size = float(np.hypot(before.size, force.size))
            found[force.index] = replace(before, size=size)
        elif len(found) == MAX_UNKNOWN_FORCES:
            return None
        else:
            found[force.index] = force
        problem = disturbed(now.problem, force)
        try:
            minimum = problem.fitted(now.moments, now.minimum.values)
        except (NotConverged, RankDeficient):
            return None
        now = replace(now, problem=problem, minimum=minimum)
    if not found or now.excess > MAX_REDUCED_CHI2:
        return None
    effects = tuple(
        Finding(
            code=Code.UNKNOWN_FORCE,
            where=f"actuator {force.actuator}",
            actuators=(force.actuator,),
            probability=float(np.exp(force.log_probability)),
            size=force.size,
            unit="N",
            remedy="look for friction, dust in its gap or a cable at it",
        )
        for force in found.values()
    )
    return replace(now, effects=(*now.effects, *effects))


def _correlated(start: ExaminedFit, effects: tuple[Finding, ...]) -> ExaminedFit:
    """Return the fit to noise that hangs together from row to row, as sure as zeros by file leave.

    Where it is slow each file has zeros of its own, which shapes do not feel but statics do.
    """
    moved = correction(start.rows, ZEROS_OF_EACH)
    found = Finding(
        code=Code.CORRELATED_NOISE,
        probability=1.0 - start.probability,
        size=start.minimum.chi2 / start.problem.degrees_of_freedom(start.moments),
        remedy="average longer at each shape, and take the shapes of each file in another order",
    )
    minimum = start.minimum if moved is None else moved.minimum
    return replace(start, minimum=minimum, effects=(*effects, found))


def _unsure(best: ExaminedFit, named_first: ExaminedFit) -> Minimum:
    """Return the minimum, less sure by what it would move if the effect named were taken out."""
    moved = named_first.minimum.values - best.minimum.values
    return with_error(best.minimum, moved[None], np.eye(1))


def _alike(found: list[EffectTest]) -> list[EffectTest]:
    """Return the likeliest effects, the one with the fewest parameters first; at most four."""
    best = found[0].log_probability
    some = [test for test in found if test.log_probability <= SIMILAR_LOG_PROBABILITY * best][
        :MAX_EFFECTS
    ]
    return sorted(some, key=lambda test: test.derivative.count)


def _as_mounting(
    fit: FittedRows, test: EffectTest, corrected: Correction
) -> tuple[EffectTest, Correction]:
    """Take zeros that leave the sum of the forces alone for a load that was put on elsewhere.

    Zeros of their size tau would move the sums by tau |nz alpha| in each file, and so spread the
    scale: that is believed unless the sums hold still as chance makes it once in a hundred times.
    """
    if test.effect is not ZEROS_OF_EACH:
        return test, corrected
    n, theta, tau2 = fit.problem.n, corrected.theta, corrected.theta @ corrected.theta
    tau2 /= max(corrected.effective_parameters, 1.0)
    along = fit.scaled_arms[0] / np.linalg.norm(fit.scaled_arms[0])
    sums = theta.reshape(-1, n) @ along
    known = corrected.covariance.reshape(len(sums), n, len(sums), n)
    spread = tau2 * np.eye(len(sums)) - np.einsum("kilj,i,j->kl", known, along, along)
    values, vectors = np.linalg.eigh(spread)
    seen = values > MIN_SEEN_SPREAD * tau2
    chi2 = float(np.sum((vectors[:, seen].T @ sums) ** 2 / values[seen]))
    if not seen.any() or chi2_cdf(chi2, np.count_nonzero(seen)) > FALSE_ALARM:
        return test, corrected
    anew = correction(fit, LOAD_REPOSITIONED)
    return (test, corrected) if anew is None else (replace(test, effect=LOAD_REPOSITIONED), anew)


def _after(
    now: ExaminedFit,
    fit: FittedRows,
    test: EffectTest,
    corrected: Correction,
    samples: Sequence[Array],
) -> ExaminedFit:
    """Return what is left after a correction."""
    structure = now.structure
    if structure is not None:
        structure = structure_of(corrected.moments, corrected.problem.noise, samples)
    effective_parameters = (
        0.0 if np.any(test.derivative.information) else corrected.effective_parameters
    )
    return replace(
        now,
        problem=corrected.problem,
        moments=corrected.moments,
        minimum=corrected.minimum,
        effective_parameters=now.effective_parameters + effective_parameters,
        effects=_with_one_more(now.effects, _found(fit, test, corrected)),
        structure=structure,
    )


def _with_one_more(effects: tuple[Finding, ...], more: Finding) -> tuple[Finding, ...]:
    """Return effects with one more; of one that was found before, with the size of both."""
    before = [effect for effect in effects if effect.code == more.code]
    if not before:
        return (*effects, more)
    size = more.size + before[0].size
    return tuple(replace(one, size=size) if one is before[0] else one for one in effects)


def _found(fit: FittedRows, test: EffectTest, corrected: Correction | None) -> Finding:
    """Return an effect in words and numbers."""
    campaign, effect = fit.problem.campaign, test.effect
    theta = np.zeros(test.derivative.count) if corrected is None else corrected.theta
    worst = int(np.abs(theta).argmax())
    where, actuators = "", tuple[int, ...]()
    if corrected is not None and effect.of == "file":
        where = campaign.cycles[worst * len(campaign.cycles) // len(theta)].name
    elif corrected is not None and effect.of == "actuator":
        ids = campaign.layout.id[campaign.layout.enabled]
        ids = ids if test.derivative.actuators is None else ids[test.derivative.actuators]
        actuators = (int(ids[worst % len(ids)]),)
        where = f"actuator {actuators[0]}"
    elif corrected is not None and effect.of == "load":
        loads = campaign.loads[-(len(theta) if len(theta) < len(campaign.loads) else 0) :]
        where = loads[worst * len(loads) // len(theta)].name
    return Finding(
        code=effect.code,
        where=where,
        actuators=actuators,
        probability=float(np.exp(test.log_probability)),
        size=float(theta[worst]),
        unit=effect.unit,
        corrected=corrected is not None and effect.corrected(fit),
        remedy=effect.remedy_of(fit),
    )
