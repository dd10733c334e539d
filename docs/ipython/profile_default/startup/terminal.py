"""Cells of a terminal, printed at once: pieces of a stream would be broken into lines."""

import subprocess
import textwrap

from IPython.core.magic import register_cell_magic

WIDTH = 116  # letters of a line on a page; columns are narrower, sentences may be longer


@register_cell_magic
def bash(_: str, cell: str) -> None:
    """Run a cell as a script and print all of its output."""
    merged = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(["bash", "-euc", cell], check=False, **merged)
    print("\n".join(map(folded, done.stdout.splitlines())))
    done.check_returncode()


def folded(line: str) -> str:
    """Return a line broken where the page ends, what goes on indented further."""
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    parts = textwrap.wrap(line, WIDTH, subsequent_indent=indent, break_on_hyphens=False,
                          break_long_words=False, replace_whitespace=False)  # fmt: skip
    return "\n".join(parts)
