"""Cells of a terminal, printed at once: pieces of a stream would be broken into lines."""

import subprocess

from IPython.core.magic import register_cell_magic


@register_cell_magic
def bash(_: str, cell: str) -> None:
    """Run a cell as a script and print all of its output."""
    merged = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(["bash", "-euc", cell], check=False, **merged)
    print(done.stdout, end="")
    done.check_returncode()
