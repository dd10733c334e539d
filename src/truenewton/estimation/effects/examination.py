"""The examination of a fit: which effects the data contain, which are taken out, and what is left.

The likeliest effect is fitted together with alpha and with all effects before it (`joint`); then
the others are tested again, with all these free, until none is significant. Of similarly likely
effects the one with the fewest parameters is taken, and of as many the one that the data support
most. The fit is accepted only if both the balance of the shapes and their repetition over loads and
signs fit. Otherwise no effect is taken out, and the errors grow with the misfit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, chi2_cdf, chi2_sf, f_sf
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.effects.catalogue import (
    LOAD_REPOSITIONED,
    ZEROS_OF_EACH,
    Effect,
    EffectTest,
    beside_shared_noise,
    effect_tests,
    significant_tests,
)
from truenewton.estimation.effects.correction import UnknownForce, disturbed, unknown_force
from truenewton.estimation.effects.derivative import FittedRows
from truenewton.estimation.effects.joint import (
    Joint,
    Part,
    correction,
    joined,
    new_part,
)
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.estimate import (
    ErrorKind,
    ScaleError,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import (
    Moments,
    Noise,
    Structure,
    structure_of,
)
from truenewton.records.campaign import Campaign, load_temperatures
from truenewton.statics.load import leaning

MAX_SIMILAR = 4  # effects that are tried
MIN_GAIN = 4.0  # of the logarithm of the likelihood, twice: evidence of 7 to 1 for an effect
MAX_UNKNOWN_FORCES = 2  # actuators with unknown forces: three can explain any imbalance
MAX_REDUCED_CHI2 = 2.0  # chi^2 over degrees of freedom that unknown forces, not normal, may leave
MIN_SEEN_SPREAD = 0.5  # of tau^2: the part of a spread of zeros that the data must contain
SIMILAR_LOG_PROBABILITY = 0.85  # of the log of the smallest probability: similarly likely effects


@dataclass(frozen=True, eq=False)
class ExaminedFit:
    """A fit after the search for effects."""

    # The data without the effects that were taken out, and their fit
    problem: Problem
    moments: Moments
    minimum: Minimum
    effective_parameters: float = 0.0  # number of parameters of these that the balance determined
    effects: tuple[Finding, ...] = ()  # findings, the likeliest first
    # How well shapes repeat over loads and signs; None if not tested
    structure: Structure | None = None
    # Whether noise is correlated from row to row, so that shapes may balance too well
    correlated: bool = False
    # Whether the data fit without an effect that was named but not taken out
    explained: bool = False

    @cached_property
    def rows(self) -> FittedRows:
        """The rows at the fit, whose readings are independent."""
        return FittedRows(self.problem, self.moments, self.minimum, independent=True)

    @cached_property
    def freedom(self) -> float:
        """Degrees of freedom of the balance."""
        return self.problem.degrees_of_freedom(self.moments) - self.effective_parameters

    @cached_property
    def probability(self) -> float:
        """Chance of a larger chi^2 of the balance."""
        return chi2_probability(self.minimum.chi2, self.freedom, self.problem.noise)

    @cached_property
    def too_well(self) -> bool:
        """Whether the shapes balance better than expected of their noise."""
        return self.freedom > 0 and self.probability > 1.0 - LIMITS.fit_probability

    @cached_property
    def fits(self) -> bool:
        """Whether both the balance and the repetition of shapes fit."""
        repeated = self.structure is None or self.structure.probability > LIMITS.fit_probability
        return (
            self.probability > LIMITS.fit_probability
            and repeated
            and (self.correlated or not self.too_well)
        )

    @cached_property
    def excess(self) -> float:
        """Ratio of the residual variance to that of the noise, at least 1."""
        balance = self.minimum.chi2 / max(self.freedom, 1.0)
        return max(1.0, balance, self.structure.reduced if self.structure else 1.0)


def chi2_probability(chi2: float, freedom: float, noise: Noise) -> float:
    """Return the probability of a larger chi^2, given how well the noise is known."""
    if freedom <= 0:
        return 1.0
    if np.isinf(noise.share_freedom):
        return float(chi2_sf(chi2, freedom))
    return float(f_sf(chi2 / freedom, freedom, noise.share_freedom))


def misfit_findings(left: ExaminedFit) -> Iterator[Finding]:
    """Yield the finding of a misfit, and the factor by which the errors were increased.

    Coils whose gain depends on the displacement leave an imbalance that is even in the sign of the
    shape. Without POSITION it cannot be removed, and other effects explain part of it.
    """
    if left.effects and left.moments.displacement is None:
        yield Finding.of(Code.EFFECT_WITHOUT_POSITION)
    if left.fits:
        return
    if left.explained:
        yield Finding.of(Code.MISFIT_EXPLAINED)
    elif left.excess > 1.0:
        yield Finding.of(Code.MISFIT, factor=float(np.sqrt(left.excess)))
    elif left.too_well and left.structure is not None:
        yield Finding.of(Code.FIT_TOO_GOOD)


def warmer_loads(campaign: Campaign, scale_errors: Iterable[ScaleError]) -> Iterator[Finding]:
    """Yield a finding if the temperature differs too much between loads."""
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


def examined(plain: ExaminedFit, structure: Structure | None, samples: Array) -> ExaminedFit:
    """Return a fit after the search for effects, without those whose correction makes it fit.

    ``structure`` is how well shapes repeat over loads and signs; None if they do not. The
    ``samples`` are (m, n) deviations of some rows from their repeats [N].
    """
    problem, moments = plain.problem, plain.moments
    if structure is None:
        return plain
    # Effects of files or hours on all readings look like shared noise until they are taken out.
    unshared = replace(problem.noise, share=1.0, share_freedom=np.inf)
    alone = replace(problem, noise=unshared, disturbance=0.0)
    if moments.pooled and not problem.dependent:
        start: ExaminedFit | None = replace(plain, structure=structure)  # fitted so already
    else:
        start = _pooled(alone, moments, plain.minimum, structure)
    if start is None:
        return plain
    # Noise that is independent within a row but balances too well is correlated from row to row.
    start = replace(start, correlated=start.too_well and not problem.dependent)
    done, named_first = _corrected(
        start, independent=True, samples=samples, within=problem.dependent
    )
    if start.correlated and (done is None or not done.effects):
        return _correlated(start, named_first.effects)
    if done is not None and (done.effects or not problem.dependent):
        return done
    if problem.dependent:
        start = replace(plain, structure=structure) if moments.pooled else plain
        before = named_first
        done, named_first = _corrected(start, independent=False, samples=samples)
        if done is not None:
            return done
        if start.too_well:  # even without what readings of a row share
            if before.effects:
                named_first = before
            return _with_shift(_correlated(start, named_first.effects), named_first)
    best = plain if plain.fits and not start.fits else start
    if not named_first.effects or not named_first.fits:
        for one in (start, plain):
            forced = _with_unknown_forces(one)
            if forced is not None:
                return forced
    # Two explanations of the data differ by what alpha may be wrong by.
    return replace(
        _with_shift(best, named_first),
        effects=named_first.effects,
        explained=bool(named_first.effects) and named_first.fits,
    )


def _pooled(
    problem: Problem, moments: Moments, minimum: Minimum, structure: Structure
) -> ExaminedFit | None:
    """Return the fit to pooled rows, whether shapes repeat or not; None if it fails."""
    pooled = replace(moments, pooled=True)
    try:
        fitted = problem.fitted(pooled, minimum.values)
    except (NotConverged, RankDeficient):
        return None
    return ExaminedFit(problem, pooled, fitted, structure=structure)


def _corrected(
    start: ExaminedFit, *, independent: bool, samples: Array, within: bool = False
) -> tuple[ExaminedFit | None, ExaminedFit]:
    """Return the fit together with all effects that the data show; None if that does not fit.

    Also the fit with the first effect named, in case it cannot be taken out. With ``within`` the
    first is an effect by which rows of one group differ, which looked like shared noise.
    """
    base = start.rows
    if not independent:
        base = FittedRows(start.problem, start.moments, start.minimum, independent)
    joint: Joint | None = None
    now, first, tried = start, start, set[Code]()
    while True:
        fit, parts, given = base, tuple[Part, ...](), None
        if joint is not None:
            fit, parts, given = joint.at, joint.parts, (joint.scored, joint.covariance)
        without = tried | {part.effect.code for part in parts}
        found = effect_tests(fit, given, without, bounded=True)
        shared = within and joint is None  # noise, or such an effect
        if shared:
            found = beside_shared_noise(found, fit, samples)
        found = significant_tests(found)
        if not found:
            return (now if now.fits else None), first
        if not first.effects:
            first = replace(start, effects=(_named(fit, found[0]),))
        force = None if shared else unknown_force(fit)
        if force is not None and force.log_probability < found[0].log_probability:
            return _with_unknown_forces(now), first
        best: tuple[ExaminedFit, Joint] | None = None
        for test in _similar(found):
            # The fewest parameters that fit; of as many, what the data support most.
            if best and best[0].fits and test.derivative.count > best[1].parts[-1].count:
                break
            trial = _entered(base, fit, parts, test)
            if trial is None:
                tried.add(test.effect.code)
                continue
            fitted = _with(start, trial, samples)
            if (
                best is None
                or (fitted.fits and not best[0].fits)
                or (fitted.fits and trial.parts[-1].gain > best[1].parts[-1].gain)
            ):
                best = fitted, trial
        if best is None:
            continue
        now, joint = best
        tried |= {part.effect.code for part in parts} - {part.effect.code for part in joint.parts}
        if now.fits and not now.effects[-1].corrected:
            return None, now
        if not parts:
            first = replace(now, effects=(replace(now.effects[0], corrected=False),))


def _entered(
    base: FittedRows, fit: FittedRows, parts: tuple[Part, ...], test: EffectTest
) -> Joint | None:
    """Return the joint fit with one more effect; None if it fails, or the data do not support it.

    An effect that the data support no longer beside the new one is left out.
    """
    new = new_part(fit, test.effect, test.derivative)
    if new is None:
        return None
    joint = joined(base, (*parts, replace(new, log_probability=test.log_probability)), fit)
    while joint is not None:
        if joint.parts[-1].effect is not test.effect:
            return None
        least = min(joint.parts, key=lambda part: part.gain)
        if least.gain > MIN_GAIN:
            return joint
        if least.effect is test.effect:
            return None
        joint = joined(base, [part for part in joint.parts if part is not least], joint.at)
    return None


def _with(start: ExaminedFit, joint: Joint, samples: Array) -> ExaminedFit:
    """Return the fit together with effects."""
    structure = start.structure
    if structure is not None:
        structure = structure_of(joint.moments, joint.problem.noise, samples)
    return replace(
        start,
        problem=joint.problem,
        moments=joint.moments,
        minimum=joint.minimum,
        effective_parameters=joint.effective_parameters,
        effects=tuple(_found(joint.at, part) for part in joint.parts),
        structure=structure,
    )


def _with_unknown_forces(now: ExaminedFit) -> ExaminedFit | None:
    """Return the fit with unknown forces at some actuators until none stands out; None if poor."""
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
    """Return the fit to noise that is correlated from row to row, with the error of zeros by file.

    Slow noise gives each file zeros of its own, which cancel in shapes but not in statics.
    """
    moved = correction(start.rows, ZEROS_OF_EACH)
    found = Finding(
        code=Code.CORRELATED_NOISE,
        probability=1.0 - start.probability,
        size=start.minimum.chi2 / start.problem.degrees_of_freedom(start.moments),
        remedy="average longer at each shape, and take the shapes of each file in another order",
    )
    if moved is not None:
        start = replace(start, problem=moved.problem, minimum=moved.minimum)
    return replace(start, effects=(*effects, found))


def _with_shift(best: ExaminedFit, named_first: ExaminedFit) -> ExaminedFit:
    """Return the fit with the shift by the named effect added to its covariance."""
    moved = named_first.minimum.values - best.minimum.values
    problem, minimum = best.problem.with_error(best.minimum, moved[None], np.eye(1))
    return replace(best, problem=problem, minimum=minimum)


def _similar(found: list[EffectTest]) -> list[EffectTest]:
    """Return the likeliest effects, the one with the fewest parameters first; at most four."""
    best = found[0].log_probability
    some = [test for test in found if test.log_probability <= SIMILAR_LOG_PROBABILITY * best][
        :MAX_SIMILAR
    ]
    return sorted(some, key=lambda test: test.derivative.count)


def _effect_of(part: Part) -> Effect:
    """Return zeros of each actuator as a repositioned load if they leave the sum of forces alone.

    Zeros of spread tau would move the sums by tau |nz alpha| in each file, and so spread the scale.
    The load is named unless the sums move less than chance would have it once in a hundred times.
    """
    if part.effect is not ZEROS_OF_EACH:
        return part.effect
    assert part.covariance is not None  # it is at the end
    spreads, tau2 = part.spreads, part.variances[0]
    # The sums and their covariance as if they had the spread tau.
    known = np.linalg.inv(spreads.along(part.covariance))
    sums = known @ spreads.along(part.theta)
    covariance = np.linalg.inv(known + np.eye(len(sums)) * (1 / tau2 - 1 / part.variances[1]))
    sums = covariance @ sums
    values, vectors = np.linalg.eigh(tau2 * np.eye(len(sums)) - covariance)
    seen = values > MIN_SEEN_SPREAD * tau2
    chi2 = float(np.sum((vectors[:, seen].T @ sums) ** 2 / values[seen]))
    if not seen.any() or chi2_cdf(chi2, np.count_nonzero(seen)) > FALSE_ALARM:
        return part.effect
    return LOAD_REPOSITIONED


def _named(fit: FittedRows, test: EffectTest) -> Finding:
    """Return the finding of an effect that is not taken out."""
    return _finding(fit, test.effect, test.log_probability, corrected=False)


def _found(fit: FittedRows, part: Part) -> Finding:
    """Return the finding of an effect in a fit."""
    campaign, effect, theta = fit.problem.campaign, _effect_of(part), part.theta
    worst = int(np.abs(theta).argmax())
    where, actuators = "", tuple[int, ...]()
    if effect.of == "file":
        where = campaign.cycles[worst * len(campaign.cycles) // len(theta)].name
    elif effect.of == "actuator":
        ids = campaign.layout.id[campaign.layout.enabled]
        ids = ids if part.actuators is None else ids[part.actuators]
        actuators = (int(ids[worst % len(ids)]),)
        where = f"actuator {actuators[0]}"
    elif effect.of == "load":
        loads = list(campaign.loads)
        if len(theta) < len(loads):  # under one there is none
            del loads[int(leaning(loads).argmin())]
        where = loads[worst * len(loads) // len(theta)].name
    found = _finding(fit, effect, part.log_probability, corrected=effect.corrected(fit))
    return replace(found, where=where, actuators=actuators, size=float(theta[worst]))


def _finding(
    fit: FittedRows, effect: Effect, log_probability: float, *, corrected: bool
) -> Finding:
    remedy = effect.remedy if isinstance(effect.remedy, str) else effect.remedy(fit)
    chance = float(np.exp(log_probability))
    return Finding(
        code=effect.code, probability=chance, size=0.0, unit=effect.unit, corrected=corrected,
        remedy=remedy,
    )  # fmt: skip
