"""What changed between two simulated matrices of one mirror, against the truth.

    python -m studies.comparison [--mirror p45] [--seeds 20] [--first 40001]
        [--rejections] [--campaign]

The noise is 0.05 % of the rms element, with five noise models. Alphas change by 0.3 % and sensor
gains by 0.2 %, at random. In every second pair one alpha changes by -15 %, one coil is reversed,
and two sensors change by 3 %. Columns: the rms error of the change of alpha, times 1e-4, and
relative to the stated error; coverage of 95 % intervals of alpha and of sensor gains, with its
Monte Carlo error; changes found; false alarms in pairs without such a change; the largest pattern
of the residual; processor seconds. --rejections prints the verdicts on new matrices that were
processed, or measured on other glass, and the coverage if they are accepted. --campaign: the new
data are a simulated campaign with POSITION, of one cycle for each load. lbt672 uses the measured
matrix if its folder is given.
"""

import argparse
import time
from collections import Counter
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import truenewton as tn
from studies.matrices import measured_or_made, true_stiffness
from studies.simulated_matrices import without_modes
from truenewton.errors import TrueNewtonError
from truenewton.statics.arms import arms

LAWS = ("equal", "proportional", "mixed", "by sensor", "by modes")
LEVEL = 5e-4
SCATTER = (0.003, 0.002)  # standard deviation of the changes of alpha and of sensor gains
ANOTHER_UNIT = "another unit: alphas from 0.95 to 1.05"
SOFTEST = 3e-3  # relative singular value: the stroke limits softer modes


def noise(random, k, law, sensors):
    """Return the noise of a matrix [N/m]."""
    z, rms = random.standard_normal(k.shape), np.sqrt(np.mean(k**2))
    if law == "by modes":
        _, size, modes = np.linalg.svd(k)
        return LEVEL * (z * np.maximum(size, SOFTEST * size[0])) @ modes
    share = {"proportional": 1.0, "mixed": 0.5}.get(law, 0.0)
    z *= sensors if law == "by sensor" else 1.0
    return LEVEL * z * np.sqrt(share * k**2 + (1.0 - share) * rms**2)


def with_glass(exact, stiffer):
    """Return the true stiffness if the glass at each actuator is stiffer by (n,) fractions."""
    size, modes = np.linalg.eigh(exact)
    root = (modes * np.sqrt(np.maximum(size, 0.0))) @ modes.T  # curvatures of a plate
    return root @ ((1.0 + stiffer)[:, None] * root)


def ratios_of(random, n, *, changed):
    """Return (2, n) true ratios of alpha and gains, and which four changed."""
    ratios = 1.0 + np.array(SCATTER)[:, None] * random.standard_normal((2, n))
    four = random.choice(n, 4, replace=False)
    if changed:
        ratios[0, four[:2]] *= (0.85, -1.0)
        ratios[1, four[2:]] *= 1.03
    return ratios, four


def matrix_and_campaign(mirror, seed, law, *, changed):
    """Return a matrix, a later campaign, (2, n) true ratios and which four changed."""
    random = np.random.default_rng(seed)
    bench = tn.static_bench(mirror, seed)
    ratios, four = ratios_of(random, bench.truth.layout.n, changed=changed)
    quiet = replace(bench.sensors, noise=1e-6 * bench.sensors.noise)
    exact = campaign_of(replace(bench, force_noise=1e-10, sensors=quiet))
    matrix = tn.measured_stiffness(exact).matrix
    sensors = np.exp(0.7 * random.standard_normal(matrix.layout.n))
    old = matrix.stiffness + noise(random, matrix.stiffness, law, sensors)
    truth = replace(bench.truth, alpha=bench.truth.alpha * ratios[0], seed=seed + 1)
    # This gain is true displacement per reading; that of a row of readings is its inverse.
    gain = replace(bench.sensors, gain=bench.sensors.gain / ratios[1])
    new = campaign_of(replace(bench, truth=truth, sensors=gain))
    return replace(matrix, stiffness=old), new, ratios, four


def campaign_of(bench):
    """Return a campaign of one cycle for each load."""
    return tn.Campaign(tuple(tn.run_cycles(bench, 1)))


def pair(matrix, exact, seed, law, *, changed, later=None):
    """Return two matrices, (2, n) true ratios of alpha and gains, and which four changed.

    ``later`` is the true stiffness of the new one, if it changed.
    """
    random, n = np.random.default_rng(seed), len(exact)
    scatter = 1.0 + 0.05 * random.standard_normal(n), 1.0 + 0.004 * random.standard_normal(n)
    ratios, four = ratios_of(random, n, changed=changed)
    old, new = (
        true / scatter[0][:, None] / scatter[1]
        for true in (exact, exact if later is None else later)
    )
    new, sensors = new / ratios[0][:, None] / ratios[1], np.exp(0.7 * random.standard_normal(n))
    made = [replace(matrix, stiffness=k + noise(random, k, law, sensors)) for k in (old, new)]
    return *made, ratios, four


def covered(c, matrix, ratios):
    """Return actual and stated mean square error of alpha, and coverage for alpha and gains."""
    kept, found = np.isin(matrix.layout.id, c.layout.id[c.layout.enabled]), []
    for k, name in enumerate(("alpha", "sensor")):
        ratio, error, changed = (
            getattr(c, f"{name}{of}")[c.layout.enabled]
            for of in ("_ratio", "_ratio_error", "_changed")
        )
        true = ratios[k][kept] / np.exp(np.log(np.abs(ratios[k][kept]))[~changed].mean())
        found.append((ratio - true, error))
    (alpha, stated), _ = found
    inside = [np.mean(np.abs(off) < 1.96 * error) for off, error in found]
    return np.mean(alpha**2), np.mean(stated**2), *inside


def accuracy(drawn, seeds):
    """Print a line for each law of pairs that ``drawn`` returns for a seed and a law."""
    print(
        "noise           error  /stated  alpha, gains covered [%]   found  named  pattern  seconds"
    )
    pairs = alarms = 0
    for law in LAWS:
        rows, found, named, pattern = [], [], [], []
        start = time.process_time()
        for seed in seeds:
            changed = seed % 2 == 0
            old, new, ratios, four = drawn(seed, law, changed=changed)
            c = tn.compare(old, new)
            rows.append(covered(c, old, ratios))
            names = [{*c.layout.id[each]} for each in (c.alpha_changed, c.sensor_changed)]
            if changed:
                right = [{*old.layout.id[each]} for each in (four[:2], four[2:])]
                found.append(sum(len(a & b) for a, b in zip(names, right, strict=True)))
            else:
                moved = any((*names, c.couplings, c.matching.rows))
                named.append(moved or c.verdict.level != "sound")
            pattern.append(c.pattern)
        error, stated, *cover = np.array(rows).T
        rms, claimed = np.sqrt(error.mean()), np.sqrt(stated.mean())
        shares = [
            f"{100 * each.mean():6.1f} +- {100 * each.std() / np.sqrt(len(each)):.1f}"
            for each in cover
        ]
        print(
            f"{law:<14}{1e4 * rms:7.2f}{rms / claimed:9.2f}{shares[0]}{shares[1]}"
            f"  {sum(found):3d} of {4 * len(found):<3d} {sum(named)} of {len(named)}"
            f"{max(pattern):7.2f}{(time.process_time() - start) / len(seeds):7.2f}",
            flush=True,
        )
        pairs, alarms = pairs + len(named), alarms + sum(named)
    print(f"anything named or doubtful in {alarms} of {pairs} pairs without a change")


def processed(matrix, exact, random):
    """Yield names of faults, the true stiffness of the new matrix, and its processing."""
    n, order = len(exact), random.permutation(len(exact))
    rigid = np.linalg.qr(arms(matrix.layout).T)[0]
    x, y = (each / np.abs(each).max() for each in (matrix.layout.x, matrix.layout.y))
    smooth = sum(random.standard_normal() * x**i * y**j for i in range(4) for j in range(4 - i))
    smooth = 0.02 * (smooth - smooth.mean()) / smooth.std()
    patch = 0.01 * np.exp(-8.0 * ((x - 0.5) ** 2 + y**2))
    eighth = n // 8
    yield "transposed", exact, lambda new, _: new.T
    yield "rows and columns in another order", exact, lambda new, _: new[np.ix_(order, order)]
    yield "rows in another order", exact, lambda new, _: new[order]
    yield "other sign", exact, lambda new, _: -new
    yield "symmetrised", exact, lambda new, _: 0.5 * (new + new.T)
    yield "derived from the old one", exact, lambda _, old: 1.01 * old
    yield "derived, then float32", exact, lambda _, old: (1.01 * old).astype(np.float32) * 1.0
    yield "rigid-body modes removed", exact, lambda new, _: new - rigid @ (rigid.T @ new)
    yield (
        "stiffest eighth of modes removed",
        exact,
        lambda new, _: without_modes(new, slice(eighth)),
    )
    yield "softest eighth", exact, lambda new, _: without_modes(new, slice(-eighth, None))
    yield (
        "a quarter of the modes only",
        exact,
        lambda new, _: without_modes(new, slice(n // 4, None)),
    )
    coils = 1.0 + 0.05 * random.uniform(-1.0, 1.0, (2, n))
    yield ANOTHER_UNIT, exact, lambda new, _: new * (coils[0] / coils[1])[:, None]
    other = with_glass(exact, 0.3 * random.standard_normal(n))
    yield "another mirror: glass 30 % other", other, lambda new, _: new
    yield "glass smoothly 2 % other", with_glass(exact, smooth), lambda new, _: new
    yield "a patch of glass 1 % stiffer", with_glass(exact, patch), lambda new, _: new


def rejections(matrix, exact, seeds):
    """Print a line for each fault, all laws together."""
    found: dict[str, Any] = {}
    for seed in seeds:
        law = LAWS[seed % len(LAWS)]
        for name, later, change in processed(matrix, exact, np.random.default_rng([seed, 1])):
            old, new, ratios, _ = pair(matrix, exact, seed, law, changed=False, later=later)
            new = replace(new, stiffness=np.asarray(change(new.stiffness, old.stiffness), float))
            levels, shares = found.setdefault(name, (Counter(), []))
            try:
                c = tn.compare(old, new)
            except TrueNewtonError:
                levels["rejected"] += 1
                continue
            levels[str(c.verdict.level)] += 1
            if name == ANOTHER_UNIT:  # there is no true alpha to compare with
                continue
            shares.append(covered(c, matrix, ratios)[2])
    for name, (levels, shares) in found.items():
        counts = ", ".join(f"{count} {level}" for level, count in levels.items())
        print(f"{name:40}{counts}" + (f", covered {100 * np.mean(shares):.0f} %" if shares else ""))


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--mirror", default="p45")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=40001)
    parser.add_argument("--rejections", action="store_true")
    parser.add_argument("--campaign", action="store_true")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    if options.campaign:
        accuracy(partial(matrix_and_campaign, getattr(tn.mirrors, options.mirror)()), seeds)
        return
    matrix = measured_or_made(options.mirror)
    exact = true_stiffness(matrix)
    if options.rejections:
        rejections(matrix, exact, seeds)
    else:
        accuracy(partial(pair, matrix, exact), seeds)


if __name__ == "__main__":
    main()
