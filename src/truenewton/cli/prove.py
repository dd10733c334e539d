"""`truenewton prove`: the paper's proof code."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import typer

from truenewton.cli import options


def run(
    mirror: str = typer.Argument("p45", help="A known mirror, or a FITS file with ACTUATORS."),
    seed: int = typer.Option(0, min=0, help="Seed of alpha and the random patterns."),
    seeds: int = typer.Option(1, min=1, help="How many seeds to try, from SEED on."),
    json: bool = options.JSON,
) -> None:
    """Prove numerically that the systems C and E give alpha back (paper, section 4).

    Exit code 1 if a system has not full rank or errs by more than 20 eps cond.
    """
    from truenewton.cli.terminal import print_json, print_table, track
    from truenewton.mirrors.file import mirror_from
    from truenewton.mirrors.known import p45
    from truenewton.records.file import SUFFIXES, read_layout
    from truenewton.studies.proof import LIMIT, prove

    if mirror.endswith(SUFFIXES) and Path(mirror).exists():  # P45's numbers on another layout
        known = dataclasses.replace(p45(), name=Path(mirror).name, layout=read_layout(mirror))
    else:
        known = mirror_from(mirror)
    proofs = [(s, p) for s in track(range(seed, seed + seeds), "proving") for p in prove(known, s)]
    passed = all(p.passed for _, p in proofs)
    worst = max(p.ratio for _, p in proofs)
    if json:
        print_json(
            {
                "mirror": known.name,
                "limit": LIMIT,
                "passed": passed,
                "worst": worst,
                "proofs": [
                    {
                        "seed": s,
                        "system": p.system,
                        "matrix": p.matrix,
                        "loaded": p.loaded,
                        "rank": p.rank,
                        "unknowns": p.unknowns,
                        "singular_values": p.singular_values.tolist(),
                        "condition": p.condition,
                        "error": p.error,
                        "ratio": p.ratio,
                    }
                    for s, p in proofs
                ],
            }
        )
    else:
        print_table(
            f"{known.name}: C alpha = p and E alpha' = r, solved by SVD",
            ("seed", "system", "F", "B, M, N", "rank", "singular values", "cond", "error",
             "error/(eps cond)"),
            [
                (
                    str(s),
                    p.system,
                    p.matrix,
                    "random" if p.loaded else "0",
                    f"{p.rank} of {p.unknowns}",
                    f"{p.singular_values[0]:.3g} .. {p.singular_values[-1]:.3g}",
                    f"{p.condition:.3g}",
                    f"{p.error:.1e}",
                    f"{p.ratio:.3f}",
                )
                for s, p in proofs
            ],
        )  # fmt: skip
        verdict = "alpha comes back to machine precision" if passed else "PROOF FAILED"
        print(f"{verdict}: at most {worst:.2f} eps cond (limit {LIMIT:g})")
    if not passed:
        raise typer.Exit(1)
