"""Collects the commands, and turns errors into one line and an exit code."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import typer
from typer.core import TyperGroup

from truenewton import __version__
from truenewton.cli import calibrate, simulate, take, use
from truenewton.cli.segments import each_segment
from truenewton.cli.terminal import refuse, told
from truenewton.errors import Interrupted, TrueNewtonError

# The base of what typer raises for a wrong command line, which typer itself does not export:
# ClickException of its own copy of click.
CommandLineError: Any = typer.BadParameter.__mro__[2]
STOPPED = 130  # as a shell says of a command that Ctrl-C ended
GROUPS = {  # of --help, each with its commands and an example of each
    "To begin": {"demo": "truenewton demo -o demo/"},
    "Take data": {
        "plan": "truenewton plan campaign.toml --target 0.005",
        "acquire": "truenewton acquire campaign.toml -o campaign/",
        "import": "truenewton import feedforward.fits actuators.txt --lengths mm -o stiffness.fits",
    },
    "Calibrate": {
        "info": "truenewton info campaign/",
        "calibrate": "truenewton calibrate campaign/ -o alpha.fits",
        "recalibrate": "truenewton recalibrate after/ --known alpha.fits --actuators 17,18",
        "compare": "truenewton compare stiffness-2025.fits stiffness-2026.fits",
        "track": "truenewton track monday/ tuesday.fits friday.fits --accuracy 0.005",
    },
    "Show": {
        "report": "truenewton report campaign/ -o report.html",
        "figures": "truenewton figures alpha.fits -o figures/",
    },
    "Use": {
        "modes": "truenewton modes stiffness.fits --diameter 8.2 -o modes.fits",
        "export": "truenewton export supervisor/ --calibration alpha.fits -o calibrated/",
    },
    "Simulate": {
        "simulate": "truenewton simulate p45 -o campaign/ --cycles 4",
        "prove": "truenewton prove p45 --seeds 20",
        "mirrors": "truenewton mirrors p45 --plot",
    },
}
EXAMPLES = {name: example for group in GROUPS.values() for name, example in group.items()}
FUNCTIONS = vars(take) | vars(calibrate) | vars(use) | vars(simulate)


class Grouped(TyperGroup):
    """Commands in groups, each with a whole sentence."""

    def format_commands(self, _: Any, formatter: Any) -> None:
        """Write a section for each group."""
        for title, names in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(n, self.commands[n].get_short_help_str(200)) for n in names])


app = typer.Typer(
    name="truenewton",
    help="Force calibration of deformable mirrors from statics: true Newtons per commanded Newton.",
    cls=Grouped,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for name, example in EXAMPLES.items():
    command = FUNCTIONS[f"run_{name}"]
    if "segment" in command.__annotations__:
        command = each_segment(command)
    app.command(name=name, epilog=f"\b\nFor example:\n  {example}")(command)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"truenewton {__version__}")
        raise typer.Exit


def _json_schema(asked: bool) -> None:
    if asked:
        from truenewton.cli.json_schema import json_schema

        typer.echo(json.dumps(json_schema(), indent=2))
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
    schema: bool = typer.Option(
        False, "--json-schema", callback=_json_schema, help="Print the JSON Schema of --json."
    ),
) -> None:
    pass


def main() -> None:
    """Run the command line.

    Exit code 0; 1 if a requested check fails; 2 with one line on standard error if the input or the
    output is at fault; 130 with one line if it was interrupted.
    """
    for stream in (sys.stdout, sys.stderr):
        # A terminal may lack a character, and a file name may be no text.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        code = _run()
    finally:
        _discard_unwritten()
    raise SystemExit(code)


def _run() -> Any:
    """Run the command line and return its exit code."""
    try:
        with (
            _sigterm_as_interrupt(),
            warnings.catch_warnings(),
        ):  # the commands themselves show each verdict
            warnings.simplefilter("ignore")
            # An overflow or an undefined value in an array ends the command as an error does.
            warnings.filterwarnings("error", "(?!coroutine)", RuntimeWarning)
            code = app(sys.argv[1:] or ["--help"], prog_name="truenewton", standalone_mode=False)
        if code == STOPPED:  # typer returns it after Ctrl-C
            raise KeyboardInterrupt
        if sys.stdout is not None:  # a shell may have closed it
            sys.stdout.flush()
        return code or 0
    except Interrupted as stopped:
        return refuse(str(stopped), STOPPED)
    except TrueNewtonError as error:
        return refuse(told(error))
    except CommandLineError as error:
        command = " ".join(["truenewton", *(word for word in sys.argv[1:2] if word in EXAMPLES)])
        fault = error.format_message().rstrip(".")
        see = " See" if fault.endswith("?") else "; see"  # it asks what was meant
        return refuse(f"{fault}{see} '{command} --help'")
    except (typer.Abort, KeyboardInterrupt):
        return refuse("interrupted; nothing was left half-written", STOPPED)
    except BrokenPipeError:  # the reader of our output went away, as in `| head`
        return 0
    except SystemExit as left:
        # typer exits by itself if the reader of our output went away.
        return 0 if isinstance(left.__context__, BrokenPipeError) else left.code
    except (ArithmeticError, RuntimeWarning, ValueError) as error:
        if isinstance(error, ValueError) and type(error).__name__ != "LinAlgError":
            raise
        return refuse(told(error))
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return refuse(f"{where}{error.strerror or error}")
    except MemoryError:
        return refuse("not enough memory; give fewer files at once")


@contextlib.contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Let SIGTERM end a command as Ctrl-C does, so that no half-written output stays."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _discard_unwritten() -> None:
    """Write what the standard streams still contain, or discard what cannot be written.

    A write that failed leaves its text in the buffer. Python writes it again when it ends, and if
    that fails too, its exit code is 120 instead of ours (signal module, Note on SIGPIPE).
    """
    for stream in (sys.__stdout__, sys.__stderr__):
        if stream is None or stream.closed:
            continue
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
