"""What is run: each command, how often, its lines, the files that they read, its options."""

from __future__ import annotations

from typing import NamedTuple

GROUPS = {
    "CYCLES": "c/bare-001.fits c/bare-002.fits c/ring-001.fits c/ring-002.fits",
    "DAYS": "day0.fits day1.fits day2.fits day3.fits",
    "GLASS": "mirror.toml actuators.csv",
    "TABLE": "table.toml table.ecsv",
}
# A command, its weight, its options with the kind of their values; then words | files it reads.
LINES = """
calibrate 24 --method:text --population:flag --mirror:text --anyway:flag --json:flag -o:text
    c | CYCLES
    c --method svd | CYCLES
    c --method auto | CYCLES
    c --method reciprocity --mirror mirror.toml | CYCLES GLASS
    c --population -o out.fits | CYCLES
    c stiffness.fits --json | CYCLES stiffness.fits
    stiffness.fits | stiffness.fits
    stiffness.fits --method reciprocity -o out.fits | stiffness.fits
info 11 --method:text --population:flag --json:flag
    c | CYCLES
    c --json | CYCLES
    stiffness.fits | stiffness.fits
    ml.fits | ml.fits
    svd.fits --json | svd.fits
    rec.fits | rec.fits
    feed.fits --json | feed.fits
    track.fits | track.fits
    m.fits | m.fits
    c.truth.fits | c.truth.fits
report 5 --method:text --population:flag --mirror:text --calibration:text --diameter:number \
  --efficiency:number --segment:integer --json:flag
    c -o out.html | CYCLES
    c -o out.html --calibration ml.fits --diameter 0.4 --efficiency 0.5 | CYCLES ml.fits
    c -o out.html --mirror mirror.toml | CYCLES GLASS
    stiffness.fits -o out.html | stiffness.fits
    ml.fits -o out.html | ml.fits
    rec.fits -o out.html | rec.fits
    ml.fits day1.fits -o out.html | ml.fits day1.fits
figures 2.5
    c -o out | CYCLES
    ml.fits -o out | ml.fits
    stiffness.fits -o out | stiffness.fits
plan 14 --target:number --json:flag --new:flag -o:text --plot:text
    plan.toml | plan.toml GLASS
    plan.toml --plot out.png | plan.toml GLASS
    loop.toml | loop.toml GLASS
    away.toml | away.toml
    measured.toml | measured.toml stiffness.fits
    given.toml | given.toml shapes.fits
    ecsv.toml | TABLE
acquire 9 -o:text
    plan.toml -o run --yes | run/* run/* plan.toml GLASS
    done.toml -o done --yes | done/* done/* done.toml GLASS
    plan.toml -o out --yes | plan.toml GLASS
    loop.toml -o out --yes | loop.toml GLASS
    away.toml -o out --yes | away.toml
    given.toml -o out --yes | given.toml shapes.fits
import 14 --unit:text --lengths:text --curvature:number --arc:flag --mirror:text --ids:text \
  --dataset:text --shell:integer --transpose:flag --date:text --json:flag -o:text
    f/ff.fits f/xy.csv -o out.fits | f/ff.fits f/xy.csv
    f/ff.npy f/xy.txt --json | f/ff.npy f/xy.txt
    f/ff.npz | f/ff.npz
    f/ff.mat --curvature 1.955 | f/ff.mat
    f/ff.h5 | f/ff.h5
    f/ff.csv f/xy.txt -o out.fits | f/ff.csv f/xy.txt
    f/ff.npy f/xy.fits | f/ff.npy f/xy.fits
    f/ff.fits f/xy.csv --ids f/xy.txt | f/ff.fits f/xy.csv f/xy.txt
    stiffness.fits actuators.csv | stiffness.fits actuators.csv
    s -o out.fits | s/*
    s s | s/*
    s f/xy.txt --mirror p45 | s/* f/xy.txt
    o | o/*
    c f/xy.txt | f/xy.txt
export 5 --anyway:flag --quiet:flag -o:text --calibration:text
    s --calibration chan.fits -o out | s/* chan.fits
    s --calibration ml.fits -o out | s/* ml.fits
    o --calibration chan.fits -o out | o/*
track 10 --accuracy:number --json:flag --anyway:flag -o:text
    day0.fits day1.fits day2.fits day3.fits | DAYS
    day0.fits day1.fits day2.fits day3.fits --accuracy 0.005 --anyway | DAYS
    day0.fits day3.fits | day0.fits day3.fits
    ml.fits rec.fits day1.fits | ml.fits rec.fits day1.fits
    c day1.fits day2.fits | CYCLES day1.fits
    day0.fits day1.fits day2.fits --figures out | DAYS
recalibrate 12 --actuators:text --known:text --json:flag --anyway:flag -o:text
    c --known ml.fits --actuators 3 | ml.fits ml.fits CYCLES
    c --known ml.fits --actuators auto | ml.fits ml.fits CYCLES
    c --known rec.fits --actuators auto | rec.fits rec.fits CYCLES
    c --known feed.fits --actuators auto | feed.fits feed.fits CYCLES
    c --known track.fits --actuators 3 | track.fits track.fits CYCLES
    c --known track.fits --actuators auto | track.fits track.fits CYCLES
    c/bare-001.fits --known track.fits --actuators 3,4 -o out.fits --json | track.fits
modes 7 --seeing:number --outer-scale:number --diameter:number --radius:number --power:number \
  --total-power:number --force:number --efficiency:number --off:text --slaved:text --json:flag
    c | CYCLES
    c --calibration ml.fits --json | CYCLES ml.fits
    stiffness.fits --calibration rec.fits -o out.fits | stiffness.fits rec.fits
    stiffness.fits --json | stiffness.fits
    stiffness.fits --calibration ml.fits --off 3 --slaved 5 | stiffness.fits ml.fits
simulate 4 --cycles:integer --seed:integer --noise:number --temperature:number --fidelity:text
    mirror.toml -o out --cycles 1 | GLASS mirror.toml
    mirror.toml -o out --cycles 1 --fidelity loop | GLASS mirror.toml
    table.toml -o out --cycles 1 | TABLE
prove 3 --seed:integer --seeds:integer --json:flag
    mirror.toml | GLASS
    c/bare-001.fits | c/bare-001.fits
    table.toml | TABLE
mirrors 3 --json:flag --plot:flag -o:text
    mirror.toml --json | GLASS
    table.toml --plot -o out.png | TABLE
    |
demo 0.15 --seed:integer -o:text
    -o out |
"""


class Command(NamedTuple):
    """A command: its weight, kinds of the values of its options, (words, files) of its lines."""

    weight: float
    options: dict[str, str]
    lines: list[tuple[list[str], list[str]]]


def commands() -> dict[str, Command]:
    """Return the commands of `LINES`, by name."""
    found: dict[str, Command] = {}
    for line in LINES.replace("\\\n", "").strip().splitlines():
        if not line.startswith("    "):
            name, weight, *options = line.split()
            kinds = dict(option.split(":") for option in options)
            found[name] = command = Command(float(weight), kinds, [])
            continue
        words, files = line.split("|")
        for group, members in GROUPS.items():
            files = files.replace(group, members)
        command.lines.append((words.split(), files.split()))
    return found


COMMANDS = commands()
