"""`truenewton prove`: the paper's proof code."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import typer

from truenewton.cli import options


def run(
    mirror: str = typer.Argument("p45", help="A known mirror, or a FITS file with ACTUATORS."),
    seed: int = typer.Option(0, min=0, help="Seed of alpha and the random patterns."),
    seeds: int = typer.Option(1, min=1, max=1000, help="How many seeds to try, from SEED on."),
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Prove numerically that the systems C and E give alpha back (paper, section 4).

    Exit code 1 if a system has not full rank or errs by more than 20 eps cond.
    """
    from truenewton.cli.terminal import print_result, table_lines, track
    from truenewton.mirrors.file import mirror_from
    from truenewton.mirrors.known import p45
    from truenewton.records.file import SUFFIXES, read_layout
    from truenewton.studies.proof import proof_rows, proof_values, proof_verdict, prove

    if mirror.endswith(SUFFIXES) and Path(mirror).exists():  # P45's numbers on another layout
        known = dataclasses.replace(p45(), name=Path(mirror).name, layout=read_layout(mirror))
    else:
        known = mirror_from(mirror)
    proofs = [p for s in track(range(seed, seed + seeds), "proving") for p in prove(known, s)]
    title = f"{known.name}: C alpha = p and E alpha' = r, solved by SVD"
    lines = [*table_lines(title, *proof_rows(proofs)), proof_verdict(proofs)]
    values = proof_values(known.name, proofs) if json else None
    print_result(
        lines,
        values=values,
        schema="prove",
        quiet=quiet,
    )
    if not all(one.passed for one in proofs):
        raise typer.Exit(1)
