"""README, docs, messages and help are in plain English: no banned word, no long sentence."""

import ast
import re
from pathlib import Path

import pytest
import typer

from truenewton import errors
from truenewton.calibration.summary import MEANINGS
from truenewton.cli.main import app
from truenewton.comparison.summary import MEANINGS_OF_CHANGES
from truenewton.estimation.findings.catalogue import ENTRIES

ROOT = Path(__file__).parents[2]
EXCEPTIONS = {"api.md", "changelog.md", "contributing.md"}  # made from elsewhere
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]
PAGES = [page for page in PAGES if page.name not in EXCEPTIONS and "_build" not in page.parts]
MAX_WORDS = 30  # of a message
MAX_WORDS_ON_PAGE = 25
BANNED = re.compile(
    r"\b(tells?|telling|told|stands?|bears?|born[e]?|serves?|feign\w*|drown\w*|cures?|believes?"
    r"|whoever|anew|dear|doors?|towers?|houses?|famil(y|ies)|at home|lots? of|likeliest"
    r"|modal base)\b"
    r"|(?-i:^([-*] )?(Who|Where|Elsewhere|Of which|Else)\b(?! to start))",
    re.IGNORECASE,
)

BANNED_MESSAGE = re.compile(
    r"\b(holds?|held(?!-)|nobody|somebody|put on|looked at|knows?|say|says|as if in|taken for)\b",
    re.IGNORECASE,
)


def sentences_of(text):
    """Return the sentences of a message, without names of files, options and values."""
    text = re.sub(r"`[^`]*`|\{[^{}]*\}|\b[A-Z]{2,}\b", "x", text)
    return [" ".join(part.split()) for part in re.split(r"(?<=[.:;?!])\s|\n\n", text)]


def literals(node):
    """Yield the texts of an argument; the values in an f-string are x."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        yield "".join(str(v.value) if isinstance(v, ast.Constant) else "x" for v in node.values)
    elif isinstance(node, ast.IfExp):
        yield from (*literals(node.body), *literals(node.orelse))


def messages():
    """Yield the texts of findings, errors, remedies and help, each with its place."""
    for code, entry in ENTRIES.items():
        yield from ((str(code), text) for text in (entry.name, entry.sentence, entry.remedy))
    yield from (
        (str(level), text) for level, text in (*MEANINGS.items(), *MEANINGS_OF_CHANGES.items())
    )
    for name, command in typer.main.get_command(app).commands.items():
        yield name, command.help
        yield from ((name, getattr(each, "help", None) or "") for each in command.params)
    raised = {*vars(errors), "BadParameter"}
    for path in sorted((ROOT / "src").rglob("*.py")):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(call, ast.Call):
                continue
            named = getattr(call.func, "attr", getattr(call.func, "id", "")) in raised
            said = list(call.args) if named else []
            said += [each.value for each in call.keywords if each.arg in ("fault", "remedy")]
            yield from ((f"{path.name}:{call.lineno}", text) for a in said for text in literals(a))


def test_messages_and_help_are_short_and_plain():
    every = [(where, part) for where, text in messages() for part in sentences_of(text)]
    assert len(every) > 1000
    assert [each for each in every if len(each[1].split()) > MAX_WORDS] == []
    banned = [BANNED, BANNED_MESSAGE]
    assert [each for each in every if any(words.search(each[1]) for words in banned)] == []


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
    assert [s for s in sentences if len(s.split()) > MAX_WORDS_ON_PAGE] == []
    assert [s for s in sentences if BANNED.search(s)] == []
