"""`truenewton simulate`: a campaign on the simulated bench."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options


def run(
    mirror: str = typer.Argument(..., help="A known mirror, or its TOML file (docs/mirrors.md)."),
    output: Path = typer.Option(..., "-o", "--output", help="Folder for the cycle files."),
    cycles: int = typer.Option(4, min=1, max=999, help="Cycles for each load."),
    seed: int = typer.Option(1, min=0, help="Decides everything random."),
    noise: float = typer.Option(1e-4, min=0.0, max=1.0, help="Of one force reading [N]; static."),
    fidelity: str = options.FIDELITY,
    temperature: float = typer.Option(20.0, min=-50.0, max=80.0, help="Of the magnets [deg C]."),
    overwrite: bool = options.OVERWRITE,
    quiet: bool = options.QUIET,
) -> None:
    """Simulate a campaign with and without the ring: OUTPUT, and its truth in OUTPUT.truth.fits."""
    from truenewton.bench.simulated.bench import FIDELITIES
    from truenewton.bench.simulated.segmented import bench_of, campaign_on, truth_of
    from truenewton.bench.simulated.truth import truth_path, write_truth
    from truenewton.cli.terminal import print_result, track
    from truenewton.files.outputs import atomic_outputs, refuse_existing
    from truenewton.mirrors.file import whole_mirror_from
    from truenewton.records.file import write_campaign
    from truenewton.rounding import counted

    refuse_existing(output, truth_path(output), overwrite=overwrite)
    if fidelity not in FIDELITIES:
        raise typer.BadParameter(f"there is no fidelity '{fidelity}': static or loop")
    known = whole_mirror_from(mirror)
    bench = bench_of(known, seed, force_noise=noise, temperature=temperature)
    truth = truth_of(bench)
    total, shapes = cycles * len(truth.loads), 2 * len(bench.shapes)
    made = campaign_on(bench, cycles, fidelity)
    with atomic_outputs():
        write_campaign((next(made) for _ in track(range(total), "simulating")), output,
                       overwrite=overwrite)  # fmt: skip
        write_truth(truth, truth_path(output), overwrite=overwrite)
    line = (
        f"{output}: {bench.mirror.name}, {counted(truth.loads, 'load')} x"
        f" {counted(cycles, 'cycle')} x {counted(shapes, 'shape')};"
        f" truth in {truth_path(output).name}"
    )
    print_result([line], *((output, truth_path(output)) if quiet else ()), quiet=quiet)
