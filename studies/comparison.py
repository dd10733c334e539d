"""What changed between two simulated matrices of one mirror, against the truth.

    python -m studies.comparison [--mirror p45] [--seeds 20] [--first 101]

Noise of 0.05 % of the rms element in five laws; alphas change by 0.3 % and sensor gains by 0.2 %,
at random. In half of the pairs one alpha changes by -15 %, one coil is reversed, and two sensors
change by 3 %. Columns: the rms error of the change of alpha and in units of the stated error, both
times 1e-4; coverage of 95 % intervals of alpha and of sensor gains; changes found of 4; pairs
without such a change in which any was named; the largest pattern of the residual; processor
seconds. lbt672 is built on the measured matrix where its folder is given.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

import truenewton as tn
from studies.matrices import measured_or_made, true_stiffness

LAWS = ("equal", "proportional", "mixed", "by sensor", "by modes")
LEVEL = 5e-4
SCATTER = (0.003, 0.002)  # of the changes of alpha and of sensor gains
SOFTEST = 3e-3  # of the largest singular value: the stroke limits softer modes


def noise(random, k, law, sensors):
    """Return the noise of a matrix [N/m]."""
    z, rms = random.standard_normal(k.shape), np.sqrt(np.mean(k**2))
    if law == "by modes":
        _, size, modes = np.linalg.svd(k)
        return LEVEL * (z * np.maximum(size, SOFTEST * size[0])) @ modes
    share = {"proportional": 1.0, "mixed": 0.5}.get(law, 0.0)
    z *= sensors if law == "by sensor" else 1.0
    return LEVEL * z * np.sqrt(share * k**2 + (1.0 - share) * rms**2)


def pair(matrix, exact, seed, law, *, changed):
    """Return two matrices, (2, n) true ratios of alpha and gains, and which four changed."""
    random, n = np.random.default_rng(seed), len(exact)
    scatter = 1.0 + 0.05 * random.standard_normal(n), 1.0 + 0.004 * random.standard_normal(n)
    old = exact / scatter[0][:, None] / scatter[1]
    ratios = 1.0 + np.array(SCATTER)[:, None] * random.standard_normal((2, n))
    four = random.choice(n, 4, replace=False)
    if changed:
        ratios[0, four[:2]] *= (0.85, -1.0)
        ratios[1, four[2:]] *= 1.03
    new, sensors = old / ratios[0][:, None] / ratios[1], np.exp(0.7 * random.standard_normal(n))
    made = [replace(matrix, stiffness=k + noise(random, k, law, sensors)) for k in (old, new)]
    return *made, ratios, four


def main():
    """Print a line for each law."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--mirror", default="p45")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=101)
    options = parser.parse_args()
    matrix = measured_or_made(options.mirror)
    exact = true_stiffness(matrix)
    print(f"{options.mirror:<14}  error  /stated  alpha  gains  found  named  pattern  seconds")
    for law in LAWS:
        errors, stated, covered, found, named, pattern = [], [], [], [], [], []
        start = time.process_time()
        for seed in range(options.first, options.first + options.seeds):
            changed = seed % 2 == 0
            old, new, ratios, four = pair(matrix, exact, seed, law, changed=changed)
            c = tn.compare(old, new)
            kept = np.isin(matrix.layout.id, c.layout.id)
            about = ~(c.alpha_changed), ~(c.sensor_changed)
            results = (
                (c.alpha_ratio, c.alpha_ratio_error),
                (c.sensor_ratio, c.sensor_ratio_error),
            )
            for k, (ratio, error) in enumerate(results):
                true = ratios[k][kept] / np.exp(np.log(np.abs(ratios[k][kept]))[about[k]].mean())
                covered.append((np.abs(ratio - true) < 1.96 * error).mean())
                if k == 0:
                    errors.append(np.mean((ratio - true) ** 2))
                    stated.append(np.mean(error**2))
            names = {*c.layout.id[c.alpha_changed], *c.layout.id[c.sensor_changed]}
            if changed:
                found.append(len(names & {*matrix.layout.id[four]}))
            else:
                named.append(len(names) > 0)
            pattern.append(c.pattern)
        rms, claimed = np.sqrt(np.mean(errors)), np.sqrt(np.mean(stated))
        seconds = (time.process_time() - start) / options.seeds
        print(
            f"{law:<14}{1e4 * rms:7.2f}{rms / claimed:9.2f}{np.mean(covered[::2]):7.3f}"
            f"{np.mean(covered[1::2]):7.3f}{np.mean(found):7.2f}{np.mean(named):7.3f}"
            f"{max(pattern):9.2f}{seconds:9.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
