"""Figures within a web page: valid, alike each time, apart from one another, never huge."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from truenewton.figures.style import legend_above, new_figure, plain
from truenewton.figures.writing import inline_svg


def drawn(points=20, *, label="calibrated"):
    """Return axes with marks, curves and a legend."""
    ax = new_figure(0.7).add_subplot()
    x = np.arange(points)
    ax.plot(x, np.cos(x), "o", label=label)
    ax.plot(x, np.sin(x), label="sine")
    legend_above(ax)
    return ax


def parsed(svg):
    """Return the root of an SVG element; a page needs no namespace for it, XML does."""
    return ElementTree.fromstring(
        svg.replace("<svg", '<svg xmlns:xlink="http://www.w3.org/1999/xlink"', 1)
    )


def ids(root):
    return [e.get("id") for e in root.iter() if e.get("id")]


def test_two_figures_share_no_identifier_and_refer_to_their_own():
    one, other = (inline_svg(drawn(), key) for key in ("one", "other"))
    assert one == inline_svg(drawn(), "one")
    assert not set(ids(parsed(one))) & set(ids(parsed(other)))
    known = ids(parsed(one))
    assert len(known) == len(set(known))
    wanted = re.findall(r'(?:href="#|url\(#)([^")]+)', one)
    assert wanted
    assert set(wanted) <= set(known)
    assert all(name.startswith("one-") for name in known)


def test_it_is_named_scales_and_leaves_the_page_its_style():
    svg = inline_svg(drawn(), "one")
    root = parsed(svg)
    assert (root.get("role"), root.get("aria-labelledby")) == ("img", "caption-one")
    assert root.get("width") is root.get("height") is None
    assert root.get("viewBox").startswith("0 0 238")
    assert "<style" not in svg
    assert "calibrated" in [text.text for text in root.iter("text")]


@pytest.mark.parametrize(("points", "pictures"), [(20, 0), (5000, 1)])
def test_a_crowd_of_points_becomes_a_picture(points, pictures):
    svg = inline_svg(drawn(points), "one")
    assert len(list(parsed(svg).iter("image"))) == pictures
    assert len(svg) < 150_000


def test_names_from_files_are_text():
    name = '</svg><script>window.hit=1</script>" $x_{$\n' + "long " * 40
    svg = inline_svg(drawn(label=plain(name)), "one")
    assert "<script" not in svg
    [text] = [e.text for e in parsed(svg).iter("text") if "window" in (e.text or "")]
    assert text == name[:40] + "..."
