"""Simulate: `demo`, `simulate`, `prove` and `mirrors`."""

from __future__ import annotations

import dataclasses
import inspect
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from truenewton.cli import options
from truenewton.cli.terminal import busy, print_result, say, tell
from truenewton.files.outputs import folder_beside, refuse_existing
from truenewton.progress import with_progress
from truenewton.rounding import counted, table_lines

if TYPE_CHECKING:
    from truenewton.mirrors.known import Mirror
    from truenewton.mirrors.segmented import SegmentedMirror

DEMO_FILES = ("p45", ".fits", ".html", "figures")  # in the folder of an older demo


def run_demo(
    output: Path = options.output("Folder for all files.", Path("truenewton-demo")),
    seed: int = options.SEED,
    overwrite: bool = options.OVERWRITE,
    quiet: bool = options.QUIET,
) -> None:
    """Run all steps on a simulated P45: campaign, calibration, truth, report, figures."""
    from truenewton.bench.simulated.static import run_cycles, static_bench
    from truenewton.bench.simulated.truth import truth_path, write_truth
    from truenewton.calibration.figures import write_figures
    from truenewton.calibration.methods import calibrate
    from truenewton.calibration.summary import summary_lines
    from truenewton.mirrors.known import p45
    from truenewton.reading import read_campaign
    from truenewton.records.file import write_campaign
    from truenewton.report.findings import investigate
    from truenewton.report.page.page import write_report
    from truenewton.studies.scoring import score, truth_lines

    def show(*lines: object) -> None:
        if not quiet:
            tell(map(str, lines))

    with folder_beside(output, DEMO_FILES, overwrite=overwrite) as work:
        bench, campaign = static_bench(p45(), seed), work / "p45"
        show("1. A simulated campaign: P45 under 2 loads, 4 cycles each, 45 shapes with both signs")
        write_campaign(run_cycles(bench, 4), campaign)
        write_truth(bench.truth, truth_path(campaign))
        show(f"   {output / 'p45'}", "")

        show("2. The calibration, by maximum likelihood")
        data = read_campaign(campaign)
        findings = investigate(data)  # reads the rows once for calibration and report
        calibration = findings.calibration
        assert calibration is not None  # the campaign is sound
        calibration.write(work / "alpha.fits")
        show(*summary_lines(calibration))
        show(f"   {output / 'alpha.fits'}", "")

        show("3. Comparison with the true values of the simulation")
        scores = [score(each, bench.truth) for each in (calibration, calibrate(data, "svd"))]
        lines = truth_lines(calibration, bench.truth, bench.loads, *scores)
        show(*(f"   {line}" for line in lines), "")

        show("4. The report and the figures of the paper")
        page = output / "report.html"
        command = shlex.join(["truenewton", "report", str(output / "p45"), "-o", str(page)])
        write_report(work / page.name, findings, command=command)
        show(f"   {page}: opens in any browser")
        written = write_figures(calibration, work / "figures")
        names = ", ".join(path.stem for path in written[::2])
        show(f"   {output / 'figures'}: {names} (PDF, PNG)")
    if quiet:
        say(f"written: {output}")


def run_simulate(
    mirror: str = typer.Argument(..., help="A known mirror, or its TOML file (docs/mirrors.md)."),
    output: Path = options.output("Folder for the cycle files.", ...),
    cycles: int = typer.Option(4, min=1, max=999, help="Cycles for each load."),
    seed: int = options.SEED,
    noise: float = options.NOISE,
    fidelity: str = options.FIDELITY,
    temperature: float = typer.Option(
        20.0, min=-50.0, max=80.0, help="Magnet temperature [deg C]."
    ),
    overwrite: bool = options.OVERWRITE,
    quiet: bool = options.QUIET,
) -> None:
    """Simulate a campaign with and without an added weight. OUTPUT.truth.fits: true values."""
    from truenewton.bench.simulated.bench import FIDELITIES
    from truenewton.bench.simulated.static import bench_of, campaign_on, truth_of
    from truenewton.bench.simulated.truth import truth_path, write_truth
    from truenewton.mirrors.file import whole_mirror_from
    from truenewton.records.file import write_campaign

    sealed = truth_path(output)
    refuse_existing(output, sealed, overwrite=overwrite)
    if fidelity not in FIDELITIES:
        raise typer.BadParameter(f"there is no fidelity '{fidelity}': static or loop")
    with busy("simulating"):
        bench = bench_of(
            whole_mirror_from(mirror), seed, force_noise=noise, temperature=temperature
        )
        truth = truth_of(bench)
        made = campaign_on(bench, cycles, fidelity)
        shown = with_progress(made, cycles * len(truth.loads), "cycles")
        write_campaign(shown, output, overwrite=overwrite)
        write_truth(truth, sealed, overwrite=overwrite)
    loads, shapes = counted(truth.loads, "load"), counted(bench.shapes, "shape")
    line = (
        f"{output}: {bench.mirror.name}, {loads}, {counted(cycles, 'cycle')} per load, {shapes}"
        f" with both signs; true values: {sealed.name}"
    )
    print_result([line], *((output, sealed) if quiet else ()), quiet=quiet)


def run_prove(
    mirror: str = typer.Argument("p45", help="A known mirror, or a FITS file with ACTUATORS."),
    seed: int = typer.Option(0, min=0, help="Seed of alpha and the random patterns."),
    seeds: int = typer.Option(1, min=1, max=1000, help="Number of seeds, starting at SEED."),
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Verify numerically that the systems C and E of the paper (section 4) recover alpha.

    Exit code 1 if a system does not have full rank or its error exceeds 20 eps cond.
    """
    from truenewton.files.fits import SUFFIXES
    from truenewton.mirrors.file import mirror_from
    from truenewton.mirrors.known import p45
    from truenewton.records.file import read_layout
    from truenewton.studies.proof import proof_rows, proof_values, proof_verdict, prove

    if mirror.endswith(SUFFIXES) and Path(mirror).exists():  # P45's numbers on another layout
        known = dataclasses.replace(p45(), name=Path(mirror).name, layout=read_layout(mirror))
    else:
        known = mirror_from(mirror)
    with busy("proving"):
        tried = with_progress(range(seed, seed + seeds), seeds, "seeds")
        proofs = [proof for each in tried for proof in prove(known, each)]
    title = f"{known.name}: C alpha = p and E alpha' = r, solved by SVD"
    lines = [*table_lines(title, *proof_rows(proofs)), proof_verdict(proofs)]
    values = proof_values(known.name, proofs)
    print_result(lines, values=values, schema="prove", json=json, quiet=quiet)
    if not all(one.passed for one in proofs):
        raise typer.Exit(1)


def run_mirrors(
    mirror: str = typer.Argument(
        "", help="Mirror to describe: a name, or a TOML file (docs/mirrors.md)."
    ),
    plot: bool = typer.Option(
        False, "--plot", help="Draw its actuators and glass (figure 2) as PNG."
    ),
    output: Path | None = options.output("Name of the drawing; by default MIRROR.png."),
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """List the known mirrors with the sources of their numbers, or describe and draw one."""
    from truenewton.figures.maps import plot_layout
    from truenewton.figures.writing import write_figure
    from truenewton.mirrors.file import whole_mirror_from
    from truenewton.mirrors.known import KNOWN, ring
    from truenewton.mirrors.segmented import SEGMENTED, SegmentedMirror

    if not mirror:
        if plot or output:
            raise typer.BadParameter("name a mirror to draw")
        lines, values = _list_of_mirrors()
        print_result(lines, values=values, schema="mirrors", json=json, quiet=quiet)
        return
    known = whole_mirror_from(mirror)
    if isinstance(known, SegmentedMirror):
        lines = [f"  {known.name}: {known.layout.n} actuators"]
        lines += [line for kind in known.kinds for line in _lines_of_part(known, *kind)]
    else:
        lines = [f"  {line}" for line in _lines_of(known)]
    makers = KNOWN | SEGMENTED
    source = makers.get(mirror.lower(), ring if mirror.lower().startswith("ring") else None)
    if source:
        text = re.split(r"\n\w+\n---", inspect.getdoc(source) or "")[0]
        lines += ["", *(f"  {line}".rstrip() for line in text.split("\n")[2:])]
    drawn: list[Path] = []
    if plot:
        drawn.append(output or Path(f"{known.name.lower()}.png"))
        glass = known if isinstance(known, SegmentedMirror) else known.shell
        figure = plot_layout(known.layout, edges=glass.seen_edges())
        write_figure(figure, drawn[0], overwrite=overwrite)
    numbers = _numbers(known)
    print_result(lines, *drawn, values=numbers, schema="mirror", json=json, quiet=quiet)


def _list_of_mirrors() -> tuple[list[str], dict[str, object]]:
    """Return all known mirrors as lines of tables, and as values."""
    from truenewton.mirrors.known import KNOWN, MAX_RING_ACTUATORS, ring
    from truenewton.mirrors.segmented import SEGMENTED

    mirrors = [make() for make in KNOWN.values()]
    segmented = [make() for make in SEGMENTED.values()]
    head = ("name", "actuators", "glass, mm", "thick, mm", "curvature, m", "weight, N")
    rows = [_row(one, one.name) for one in (*mirrors, ring(MAX_RING_ACTUATORS))]
    parts = [
        _row(part, f"{whole.name}, {len(alike)} x")
        for whole in segmented
        for part, alike in whole.kinds
    ]
    lines = [
        *table_lines("The known mirrors, and the largest of ring4, ring5, ...:", head, *rows),
        *table_lines("Segmented mirrors, by kind of segment:", head, *parts),
        "`truenewton mirrors NAME` prints the sources of the numbers.",
    ]
    return lines, {
        "mirrors": [_numbers(one) for one in mirrors],
        "segmented": [_numbers(one) for one in segmented],
    }


def _row(mirror: Mirror, name: str) -> tuple[str, ...]:
    shell = mirror.shell
    return (
        name,
        str(mirror.layout.n),
        f"{1e3 * shell.inner_radius:.4g} .. {1e3 * shell.outer_radius:.6g}",
        f"{1e3 * shell.thickness:.2g}",
        f"{shell.radius_of_curvature:.4g}",
        f"{mirror.weight:.4g}",
    )


def _numbers(mirror: Mirror | SegmentedMirror) -> dict[str, object]:
    """Return all numbers of a mirror, or of its segments, except the layout [SI units, deg]."""
    from truenewton.mirrors.segmented import SegmentedMirror

    name, actuators = mirror.name, mirror.layout.n
    if isinstance(mirror, SegmentedMirror):
        pairs = zip(mirror.places, mirror.segments, strict=True)
        segments = [{**dataclasses.asdict(place), **_numbers(one)} for place, one in pairs]
        return {"name": name, "actuators": actuators, "segments": segments}
    numbers = dataclasses.asdict(mirror)
    shell = numbers.pop("shell")
    if shell["outline"] is None:
        del shell["outline"]
    del numbers["layout"], numbers["name"]
    return {"name": name, "actuators": actuators, **shell, **numbers}


def _lines_of_part(whole: SegmentedMirror, part: Mirror, alike: list[int]) -> list[str]:
    places = ", ".join(
        f"{k} at {round(at.x, 9):.4g}, {round(at.y, 9):.4g} m, turned {at.turned:g} deg"
        for k, at in ((k, whole.places[k - 1]) for k in alike)
    )
    return [f"  segments {places}:", *(f"    {line}" for line in _lines_of(part))]


def _lines_of(mirror: Mirror) -> list[str]:
    """Return the numbers of a mirror in one piece, each with its unit."""
    quantities, sensor = {**mirror.shell.QUANTITIES, **mirror.QUANTITIES}, mirror.sensor
    units = {name: quantity.unit for name, quantity in quantities.items()}
    said = {"sensor": f"{sensor.inner_radius:g} to {sensor.outer_radius:g} m from its actuator"}
    if mirror.tool_radius is None:
        said["tool_radius"] = "not given"
    if mirror.shell.outline is not None:
        edge, *holes = mirror.shell.polygons()
        said["outline"] = f"{counted(edge, 'corner')}, {counted(holes, 'hole')}"
    return [
        f"{name:<22}{said.get(name, value)} {units.get(name, '') * (name not in said)}".rstrip()
        for name, value in _numbers(mirror).items()
    ]
