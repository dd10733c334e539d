"""What the site needs beyond Sphinx: every command's help, and the source that pages lead to."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import constants
from docutils import nodes
from sphinx.addnodes import download_reference, pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.search import languages
from sphinx.search.en import SearchEnglish
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode
from typer.main import get_command

import truenewton as tn
from truenewton.cli.json_schema import json_schema
from truenewton.cli.main import app

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "truenewton"
IMAGE = re.compile(r'<img src="docs/(\S+)" width="(\d+)"\s+alt="([^"]*)">')


class CommandLine(SphinxDirective):
    """Every command with its arguments and options, from what --help is made of."""

    def run(self) -> list[nodes.Node]:
        """Return a section a command."""
        group: Any = get_command(app)
        lines = [line for name, each in group.commands.items() for line in _command(name, each)]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


class JsonKeys(SphinxDirective):
    """The keys of each output of --json, from its schema."""

    def run(self) -> list[nodes.Node]:
        """Return a table with a row for each kind of output."""
        definitions = json_schema()["$defs"]
        kinds = [(name, each) for name, one in definitions.items() for each in one.get("anyOf", ())]
        rows = [(name, ", ".join(list(each["properties"])[1:])) for name, each in kinds]
        lines = ["| output | keys |", "|---|---|", *(f"| {name} | {keys} |" for name, keys in rows)]
        return self.parse_text_to_nodes("\n".join(lines))


class Constants(SphinxDirective):
    """The numbers that decide about data, each with its reason, by package."""

    def run(self) -> list[nodes.Node]:
        """Return a section a package."""
        return self.parse_text_to_nodes(constants.tables(), allow_section_headings=True)


def _command(name: str, command: Any) -> list[str]:
    context = command.make_context(name, [], resilient_parsing=True)
    shown = [one for one in command.params if one.get_help_record(context)]
    records = [one.get_help_record(context) for one in shown]
    positional = [one.get_help_record(context) for one in shown if "-" not in one.opts[0][0]]
    arguments = [record[0].split()[0] for record in positional]
    lines = [f"## truenewton {name}", "", command.help, "", "```sh"]
    lines += [" ".join(["truenewton", name, "[OPTIONS]", *arguments]), "```", ""]
    for spelling, text in records:
        lines += [f"`{spelling}`", f": {text}", ""]
    example = command.epilog.splitlines()[-1].strip()
    return [*lines, "For example:", "", "```sh", example, "```", ""]


class Search(SearchEnglish):
    """English; but some of its least words are columns of files, and are searched for."""

    stopwords = SearchEnglish.stopwords - {"after", "against", "my", "what"}


class SourceLinks(SphinxPostTransform):
    """Links to a module lead to its source on the site."""

    default_priority = 1

    def run(self, **_: Any) -> None:
        """Replace each download of a module by a reference to its page."""
        for node in list(self.document.findall(download_reference)):
            module = (Path(self.env.srcdir) / self.env.docname / ".." / node["reftarget"]).resolve()
            if module.is_relative_to(SOURCE):
                target = self.app.builder.get_relative_uri(self.env.docname, source_page(module))
                node.replace_self(nodes.reference("", "", *node.children, refuri=target))


def pages_of_the_root(_: Sphinx, page: str, source: list[str]) -> None:
    """Show README, CONTRIBUTING and CHANGELOG, whose links start from the root, as pages."""
    source[0] = source[0].replace("../README.md#", "index.md#")  # links of the other pages
    name = {"index": "README"}.get(page, page.upper())
    if page in ("index", "contributing", "changelog"):
        text = (ROOT / f"{name}.md").read_text(encoding="utf-8")
        text = text.replace("](docs/", "](").replace("](src/", "](../src/")
        text = text.replace("](CONTRIBUTING.md)", "](contributing.md)")
        text = text.replace("](CITATION.cff)", "](../CITATION.cff)")
        source[0] = IMAGE.sub(_directive, text) + ("\n" + source[0] if page == "index" else "")


def _directive(image: re.Match[str]) -> str:
    """Return a raw image of a page as a directive, so that the site has the file."""
    path, width, alt = image.groups()
    return f"```{{image}} {path}\n:width: {width}px\n:alt: {' '.join(alt.split())}\n```"


def source_page(module: Path) -> str:
    """Return the name of the page that shows a module."""
    return f"source/{module.relative_to(SOURCE).with_suffix('')}"


def source_pages(sphinx: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Give a page with the highlighted source of each module."""
    for module in sorted(SOURCE.rglob("*.py")):
        title = str(module.relative_to(SOURCE.parent))
        text = module.read_text(encoding="utf-8")
        body = sphinx.builder.highlighter.highlight_block(text, "python")
        yield source_page(module), {"title": title, "body": f"<h1>{title}</h1>{body}"}, "page.html"


def example_report(sphinx: Sphinx, error: Exception | None) -> None:
    """Write the report that the page on reports shows."""
    if error is None:
        cycles = tn.run_cycles(tn.static_bench(tn.mirrors.p45(), seed=1), 4)
        found = tn.investigate(tn.Campaign(tuple(cycles)), diameter=2.13, efficiency=0.51)
        tn.write_report(Path(sphinx.outdir) / "example-report.html", found, overwrite=True)


def documented_elsewhere(
    sphinx: Sphinx, environment: BuildEnvironment, node: pending_xref, content: nodes.Element
) -> nodes.reference | None:
    """Resolve a name as the code writes it, to where it is documented, or else to its source."""
    objects = environment.domains.python_domain.objects
    home, _, last = node["reftarget"].rpartition(".")
    kinds = {"class", "exception", "function"}
    found = [name for name in objects if name.rpartition(".")[2] == last]
    found = [objects[name] for name in found if objects[name].objtype in kinds]
    if node.get("refdomain") == "py" and len(found) == 1:
        page, place = found[0].docname, found[0].node_id
        return make_refnode(sphinx.builder, node["refdoc"], page, place, content, last)
    module = (SOURCE.parent / home.replace(".", "/")).with_suffix(".py")
    if node.get("refdomain") == "py" and home.startswith("truenewton.") and module.exists():
        target = sphinx.builder.get_relative_uri(node["refdoc"], source_page(module))
        return nodes.reference("", "", content, refuri=target, internal=True)
    return None


def setup(sphinx: Sphinx) -> dict[str, bool]:
    """Register all of it."""
    languages["en"] = Search
    sphinx.add_directive("command-line", CommandLine)
    sphinx.add_directive("json-keys", JsonKeys)
    sphinx.add_directive("constants", Constants)
    sphinx.add_post_transform(SourceLinks)
    sphinx.connect("source-read", pages_of_the_root)
    sphinx.connect("build-finished", example_report)
    sphinx.connect("missing-reference", documented_elsewhere)
    sphinx.connect("html-collect-pages", source_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
