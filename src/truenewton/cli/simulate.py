"""`truenewton simulate`: a campaign on the simulated bench."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options

NAME = "simulate"


def run(
    mirror: str = typer.Argument(..., help="A known mirror: p45, lbt672."),
    output: Path = typer.Option(..., "-o", "--output", help="Folder for the cycle files."),
    cycles: int = typer.Option(4, min=1, max=999, help="Cycles for each load."),
    seed: int = typer.Option(1, min=0, help="Decides everything random."),
    noise: float = typer.Option(1e-4, min=0.0, max=1.0, help="Of one force reading [N]."),
    overwrite: bool = options.OVERWRITE,
) -> None:
    """Simulate a campaign with and without the ring: OUTPUT, and its truth in OUTPUT.truth.fits."""
    from truenewton.bench.simulated.static import run_cycles, static_bench
    from truenewton.bench.simulated.truth import truth_path, write_truth
    from truenewton.campaign_files import write_campaign
    from truenewton.cli.printing import track
    from truenewton.mirrors import mirror as known_mirror
    from truenewton.outputs import refuse_existing

    refuse_existing(output, overwrite=overwrite)
    refuse_existing(truth_path(output), overwrite=overwrite)
    bench = static_bench(known_mirror(mirror), seed, force_noise=noise)
    total = cycles * len(bench.loads)
    run = run_cycles(bench, cycles)
    write_campaign(
        (next(run) for _ in track(range(total), "simulating")), output, overwrite=overwrite
    )
    write_truth(bench.truth, truth_path(output), overwrite=overwrite)
    shapes = 2 * len(bench.shapes)
    print(
        f"{output}: {bench.mirror.name}, {len(bench.loads)} loads x {cycles} cycles x {shapes}"
        f" shapes; truth in {truth_path(output).name}"
    )
