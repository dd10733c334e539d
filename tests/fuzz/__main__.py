"""What every command makes of spoilt files and absurd options: one line and exit code 2, or sense.

    python -m tests.fuzz [--cases 20000] [--seed 1] [--jobs 2] [--command plan] [--keep DIR]
    python -m tests.fuzz --seed 1 --only 1234 --keep DIR      one case again

Sound files of every kind are made with the project's own commands, of a mirror of 24 actuators.
Each case takes a command, spoils one or two of the files that it reads (`fuzzing`), those of one
campaign alike as a rule, or its options, and runs it in a process of its own, its folder its own,
with 4 GB and 25 s. It fails with a traceback, a hang, a signal, a warning of a library, more than
one line on standard error beside exit code 2 or any beside 0, NaN in what claims success, and where
an input was changed or a file left that is no output. Printed: cases and exit codes by command, and
the kinds of failure. Calculations that the door of the command line had to end count as failures
too: a number that was absurd by itself should have been refused as it was read.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
import os
import random
import re
import shutil
import stat
import sys
import tempfile
import traceback
from collections import Counter
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
os.environ["COLUMNS"] = "120"

import numpy as np

from truenewton.cli.main import BROKEN

from .commands import COMMANDS, GROUPS
from .files import spoil
from .process import execute, import_rooms
from .sound import make_sound
from .values import INTEGERS, NUMBERS, TEXTS

ALIKE = [GROUPS[name].split() for name in ("CYCLES", "DAYS")]  # which are spoilt in the same way
OUTPUTS = (
    "out.fits", "out.html", "out.png", "out", "out.pdf", "out.svg", "/proc/x.fits", "/dev/full",
    "/dev/null", "no/where/out.fits", "o" * 300 + ".fits", "out\n.fits", "out\udcff.fits", ".", "/",
    "c", "ml.fits", "out.fits.gz", "", "out.png/", "mirror.toml", "p45", "svd", "auto",
)  # fmt: skip


def value_of(pick: random.Random, kind: str) -> str:
    """Return a value for an option, mostly an absurd one."""
    numbers, integers = [repr(n) for n in NUMBERS], [str(n) for n in INTEGERS]
    if kind == "number":
        return pick.choice(numbers + integers if pick.random() < 0.85 else TEXTS)
    if kind == "integer":
        return pick.choice((*integers, "1e3", "1.5", "nan", str(10**30), *TEXTS[:4]))
    return pick.choice((*TEXTS, *OUTPUTS, *OUTPUTS, *numbers[:4])).replace("\0", "0")


A_LIFE = 50  # cases that one process makes: what they leave in its memory would end later ones


def make_case(
    pick: random.Random, sound: Path, folder: Path, only: str
) -> tuple[str, list[str], str]:
    """Lay out the files of a case; return its command, the words after it, and what is wrong."""
    names = [only] if only else list(COMMANDS)
    name = pick.choices(names, [COMMANDS[each].weight for each in names])[0]
    command, said = COMMANDS[name], []
    words, files = pick.choice(command.lines)
    words = list(words)
    unused = () if name == "acquire" else ("run", "done")
    shutil.copytree(sound, folder, ignore=lambda _, inside: {*unused} & {*inside})
    by_option = bool(command.options) and (not files or pick.random() < 0.25)
    if files and (not by_option or pick.random() < 0.2):
        for _ in range(pick.choice((1, 1, 1, 2))):
            said += spoil_some(pick, folder, pick.choice(files))
    for _ in range(by_option * pick.choice((1, 1, 2))):
        option, kind = pick.choice(list(command.options.items()))
        if option in words and kind != "flag":
            at = words.index(option)
            del words[at : at + 2]
        words += [option] if kind == "flag" else [option, value_of(pick, kind)]
    return name, words, "; ".join(said)


def spoil_some(pick: random.Random, folder: Path, name: str) -> list[str]:
    """Spoil a file, as a rule with those of its campaign alike; return what was done."""
    if name.endswith("*"):
        inside = sorted((folder / name).parent.rglob("*"))
        name = str(pick.choice(inside).relative_to(folder))
    kin = next((group for group in ALIKE if name in group), [name])
    some, seed = kin if pick.random() < 0.6 else [name], pick.random()
    return [
        f"{one}: {spoil(random.Random(seed), folder / one)}"
        for one in some
        if (folder / one).is_file()
    ]


def state_of(folder: Path) -> dict[str, str]:
    """Return a digest of each file in a folder, by its name."""
    state = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        digest = str(stat.S_IFMT(status.st_mode))
        if stat.S_ISREG(status.st_mode) and status.st_size < 2**26:
            digest = hashlib.sha1(path.read_bytes()).hexdigest()
        state[str(path.relative_to(folder))] = digest
    return state


def judge(command: str, words: list[str], code: int, out: str, error: str) -> str:
    """Return what is wrong with what a command said, in words that are the same for one cause."""
    lines = error.splitlines()
    if "Traceback" in error or code in (98, 99):
        frames = [":".join(found) for found in re.findall(r'/(src/\S+)", line (\d+)', error)]
        return f"traceback: {lines[-1:]} at {frames[-1:]}"[:160]
    if code == -1:
        return "hang"
    if warned := re.search(r"(\S+?):(\d+): (\w*Warning: .*)", error):
        where = re.sub(r".*/(src|site-packages)/", "", warned[1])
        return f"warning: {warned[3][:80]} at {where}:{warned[2]}"
    if code not in (0, 1, 2) or (code == 1 and command != "prove"):
        return f"exit code {code}"
    if code == 2 and not (
        len(lines) == 1 and error.startswith("truenewton: ") and error[:-1].isprintable()
    ):
        return f"{len(lines)} lines on standard error: {lines[:1]}"
    if code != 2 and lines:
        return f"standard error beside exit code {code}: {lines[0][:80]}"
    for caught in (BROKEN, "not enough memory"):
        if caught in error:
            return f"at the door: {error[error.index(caught) :][:110]}"
    if code == 0 and "--json" in words:
        found = re.search(r"\b(NaN|Infinity)\b", out)
        try:
            json.loads(out)
        except ValueError:
            found = True
        return f"JSON: {out[:60]!r}" if found else ""
    # A flat glass; any name, that of a mirror before a date; any load, any cause that was not seen.
    names = r"written: .*|'[^']*'|torques, \w+|% if \w+|^\w+(?=, \d{4}-)"
    out = re.sub(rf"radius_of_curvature +inf|{names}", "", out, flags=re.MULTILINE)
    if code == 0 and (said := re.search(r".*\b(?<!/)(nan|inf)\b(?!:|/).*", out)):
        return f"said: {re.sub(r'[0-9.]+', '#', said[0])[:90]}"
    return ""


def judge_files(
    command: str, words: list[str], code: int, before: dict[str, str], after: dict[str, str]
) -> str:
    """Return which file was left or changed that should not have been."""
    begun = ("run", "done")  # folders that `acquire` goes on with
    made = {name for name in after if name not in before}
    if command == "acquire":  # what it took is kept, whatever ends it
        folder = words[len(words) - words[::-1].index("-o")] if "-o" in words[:-1] else "out"
        folder = folder.rstrip("/")
        made = {
            name
            for name in made
            if folder not in (".", "")
            and not f"{name}/".startswith(tuple(f"{each}/" for each in (*begun, folder)))
            and not name.endswith(".truth.fits")
        }
    if code == 2 and made:
        return f"left beside exit code 2: {sorted(made)[:3]}"
    outputs = ("out", "small", *filter(None, words))
    strange = [name for name in made if "/." in f"/{name}" or not name.startswith(outputs)]
    if strange and not (command == "modes" and "-o" in words):
        return f"left: {sorted(strange)[:3]}"
    changed = [
        name
        for name, digest in before.items()
        if after.get(name) != digest and not name.startswith(begun) and name not in words
    ]
    return f"changed: {changed[:3]}" if changed else ""


def work(numbers: range, options: argparse.Namespace, sound: Path, result: Path) -> None:
    """Run some of the cases, and add a line of JSON for each."""
    with result.open("a") as file:
        for k in numbers:
            pick = random.Random(f"{options.seed}-{k}")
            beside = Path(tempfile.mkdtemp(prefix="fuzz-"))
            folder = beside / "case"
            try:
                command, words, said = make_case(pick, sound, folder, options.command)
            except Exception:
                traceback.print_exc()  # of the fuzz itself: this case is missing from the summary
                continue
            before = state_of(folder)
            code, seconds = execute(command, words, folder, beside)
            out, error = ((beside / name).read_text(errors="replace") for name in ("out", "err"))
            kind = judge(command, words, code, out, error)
            kind = kind or judge_files(command, words, code, before, state_of(folder))
            line = f"{command} {' '.join(map(repr, words))}"[:300]
            row = [k, command, code, seconds, kind, line, said, error[-300:]]
            print(json.dumps(row), file=file, flush=True)
            if options.keep and kind:
                kept = options.keep / f"{options.seed}-{k}"
                shutil.rmtree(kept, ignore_errors=True)
                shutil.move(beside, kept)
            shutil.rmtree(beside, ignore_errors=True)


def summary(rows: list[list]) -> None:
    """Print cases by command and exit code, then the kinds of failure with an example each."""
    head = ("cases", "exit 0", "1", "2", "failed", "mean s", "most s")
    print(f"{'command':<12}" + "".join(f"{word:>8}" for word in head))
    for name in (*COMMANDS, "all"):
        own = [row for row in rows if name in (row[1], "all")]
        if own:
            codes, times = Counter(row[2] for row in own), [row[3] for row in own]
            counts = (len(own), codes[0], codes[1], codes[2], sum(bool(row[4]) for row in own))
            cells = "".join(f"{count:>8}" for count in counts)
            print(f"{name:<12}{cells}{np.mean(times):>8.2f}{max(times):>8.1f}")
    kinds = Counter(row[4] for row in rows if row[4])
    print(f"{len(kinds)} kinds of failure")
    for kind, count in kinds.most_common():
        k, _, _, _, _, line, said, error = next(row for row in rows if row[4] == kind)
        print(f"{count:>5}  {kind}", f"case {k}: {line}", said, repr(error), sep="\n       ")


def fuzz() -> int:
    """Run the cases; exit code 1 where one failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=20000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--command", choices=COMMANDS, default="")
    parser.add_argument("--only", type=int, help="one case, by its number")
    parser.add_argument("--keep", type=Path, help="where cases that failed are kept")
    options = parser.parse_args()
    options.keep = options.keep and options.keep.resolve()
    first, last = (0, options.cases) if options.only is None else (options.only, options.only + 1)
    with tempfile.TemporaryDirectory() as made:
        sound = Path(made) / "sound"
        import_rooms()
        sound.mkdir()
        make_sound(sound)
        for path in sound.glob(".*"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        gc.freeze()
        result, running = Path(made) / "results", set()
        for begin in range(first, last, A_LIFE):
            if len(running) == options.jobs:
                running.discard(os.wait()[0])
            if not (child := os.fork()):
                work(range(begin, min(begin + A_LIFE, last)), options, sound, result)
                os._exit(0)
            running.add(child)
        for child in running:
            os.waitpid(child, 0)
        rows = [json.loads(line) for line in result.read_text().splitlines()]
    summary(rows)
    return int(any(row[4] for row in rows))


if __name__ == "__main__":
    sys.exit(fuzz())
