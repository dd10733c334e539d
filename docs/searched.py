"""Whether the search of the site finds every command, keyword, column, error and public name.

And whether every local link and image of the site exists.

python docs/searched.py [docs/_build]    exit code 1, with the names of what is missing
"""

from __future__ import annotations

import inspect
import json
import re
import sys
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from site_pages import Search
from typer.main import get_command

import truenewton as tn
from truenewton.cli.main import app

DOCS = Path(__file__).parent
LINK = re.compile(r'(?:href|src)="([^"]+)"')
WORD = re.compile(r"\w+")  # as Sphinx's searchtools.js parts a query


def in_tables(page: str) -> list[str]:
    """Return the keywords and columns that the tables of docs/files.md declare."""
    names, column = [], None
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if not cells:
            column = None
        elif column is None:
            column = next((k for k, head in enumerate(cells) if head in ("keyword", "column")), -1)
        elif column >= 0 and not cells[0].startswith("--"):
            names += cells[column].split(", ")
    return [name for name in names if name.isupper()]  # not the word "image"


def wanted() -> dict[str, list[str]]:
    """Return what is to be found, by the page that tells of it."""
    commands: Any = get_command(app)
    errors = [one for one in vars(tn.errors).values() if inspect.isclass(one)]
    return {
        "command-line": list(commands.commands),
        "files": in_tables((DOCS / "files.md").read_text(encoding="utf-8")),
        "api": [one.__name__ for one in errors if issubclass(one, Exception | Warning)]
        + list(tn.__all__),
    }


def pages_of(word: str, index: dict[str, Any], language: Search) -> set[str]:
    """Return the pages on which a search finds a word: in text, titles, or names of the API."""
    stem, found = language.stem(word.lower()), set()
    for terms in (index["terms"], index["titleterms"]):
        pages = terms.get(stem, terms.get(word.lower(), []))
        found |= {pages} if isinstance(pages, int) else set(pages)
    for members in index["objects"].values():
        found |= {page for page, _, _, _, name in members if name.lower() == word.lower()}
    return {index["docnames"][k] for k in found}


def broken_links(built: Path) -> list[str]:
    """Return the local links and images of the built pages that do not exist."""
    lost = []
    for page in built.rglob("[!_]*.html"):
        if "_static" in page.parts:
            continue  # templates of the theme
        for target in set(LINK.findall(page.read_text(encoding="utf-8"))):
            path = unquote(target.partition("#")[0].partition("?")[0])
            if path and not re.match(r"\w+:", path) and not (page.parent / path).exists():
                lost.append(f"{page.relative_to(built)}: {target} does not exist")
    return lost


def main() -> int:
    """Look everything up in the index that was built; print what is not found."""
    built = Path(sys.argv[1]) if len(sys.argv) > 1 else DOCS / "_build"
    text = (built / "searchindex.js").read_text(encoding="utf-8")
    index, language = json.loads(text.partition("(")[2].rpartition(")")[0]), Search({})
    everything = wanted()
    lost = [
        f"{name} is not found on {page}"
        for page, names in everything.items()
        for name in names
        if not all(page in pages_of(word, index, language) for word in WORD.findall(name))
    ]
    lost += broken_links(built)
    if lost or min(map(len, everything.values())) < 10:
        print("\n".join(lost) or "too little was looked for")
        return 1
    print(f"a search finds all {sum(map(len, everything.values()))} names")
    return 0


if __name__ == "__main__":
    sys.exit(main())
