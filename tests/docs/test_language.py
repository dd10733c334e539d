"""README and docs are in plain English: no word of the old dialect, no long sentence."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXCEPTIONS = {"api.md", "constants.md", "changelog.md", "contributing.md"}  # made from elsewhere
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]
PAGES = [page for page in PAGES if page.name not in EXCEPTIONS and "_build" not in page.parts]
MAX_WORDS = 30
BANNED = re.compile(
    r"\b(tells?|telling|told|stands?|bears?|born[e]?|serves?|feign\w*|drown\w*|cures?|believes?"
    r"|whoever|anew|dear|doors?|towers?|houses?|famil(y|ies)|at home|lots? of|likeliest)\b"
    r"|(?-i:^([-*] )?(Who|Where|Elsewhere|Of which|Else)\b(?! to start))",
    re.IGNORECASE,
)


def prose(page):
    """Return the sentences of a page, without code, formulas, output and targets of links."""
    text = page.read_text(encoding="utf-8").replace("| track: families |", "")  # a key of JSON
    text = re.sub(r"\A---\n.*?^---\n", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^ *(```|\$\$).*?^ *\1 *$", "\n\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\$[^$\n]*\$|`[^`\n]*`|<[^>]*>", "x", text.replace("$x$", ""))
    text = re.sub(r"\]\([^)]*\)|\b[A-Z]{2,}\b", "x", text)  # targets of links; names of columns
    parts = re.split(r"\n\s*\n|\n(?=[-#|:]|\d+\. )|(?<!\\)\||(?<=[.:;?!])\s", text)
    return [" ".join(part.split()) for part in parts]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_sentences_are_short_and_plain(page):
    sentences = prose(page)
    assert [s for s in sentences if len(s.split()) > MAX_WORDS] == []
    assert [s for s in sentences if BANNED.search(s)] == []
