"""The page in a real browser, as a person uses it: pointer, keyboard, phone, paper."""

import base64
import csv
import time
from dataclasses import replace

import numpy as np
import pytest

from helpers import report_data
from helpers.browser import AXE, CHROMIUM, DRIVER, TOOLTIP, Browser
from helpers.report_data import changed_by, hostile_campaign
from truenewton.comparison.calibrations import compare_calibrations
from truenewton.estimation.findings.estimate import Diagnosis
from truenewton.report.findings import investigate
from truenewton.report.page.page import write_report

pytest.importorskip("selenium", reason="selenium is not installed")
none = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="chromium or its driver is missing")
pytestmark = [pytest.mark.study, none]
needs_axe = pytest.mark.skipif(not AXE.exists(), reason="axe-core is not installed in .browser")
SELECTED = "return [...Bokeh.documents[0].get_model_by_name('actuators').selected.indices]"
ROWS = (
    "return [...document.querySelectorAll('#actuators tbody tr')]"
    ".map((r) => r.cells[0].textContent)"
)
MARKED = (
    "return [...document.querySelectorAll('#actuators tbody tr[aria-selected=true]')]"
    ".map((r) => Number(r.dataset.index))"
)
PICTURE = """
const host = document.getElementById("plot-" + arguments[0]);
const view = [...Bokeh.index.roots].find((view) => host.contains(view.el));
return view.export("png", true).canvas.toDataURL();
"""


@pytest.fixture(scope="module")
def downloads(tmp_path_factory):
    return tmp_path_factory.mktemp("downloads")


@pytest.fixture(scope="module")
def browser(downloads):
    made = Browser(downloads)
    yield made
    made.quit()


@pytest.fixture(params=[1280, 390])
def width(request, browser):
    """The width of a desk's window or of a phone's."""
    if request.param < 500:
        browser.narrow(request.param)
    yield request.param
    browser.wide()


@pytest.fixture(scope="module")
def pages(tmp_path_factory, p45_findings):
    """Return the pages by name, each with what it was made from."""
    folder = tmp_path_factory.mktemp("pages")
    found = {
        "p45": p45_findings,
        "rejected": investigate(report_data.with_outliers()),
        "no_alpha": investigate(report_data.one_load()),
        "hostile": investigate(hostile_campaign()),
        "change": compare_calibrations(*changed_by(12.0)),
        "file": investigate(
            replace(p45_findings.calibration, diagnosis=Diagnosis(), goodness=None)
        ),
    }
    for name, one in found.items():
        write_report(folder / f"{name}.html", one, command="truenewton report 'it'")
    return {name: folder / f"{name}.html" for name in found}


@pytest.mark.parametrize("name", ["p45", "rejected", "no_alpha", "hostile", "change", "file"])
def test_no_complaint_and_no_request(browser, pages, name):
    browser.open(pages[name])
    assert browser.complaints() == []
    assert browser.requests() == []
    assert browser.js("return window.hit") is None


@needs_axe
@pytest.mark.parametrize("name", ["rejected", "no_alpha", "hostile", "change"])
def test_no_serious_fault_of_accessibility(browser, pages, name):
    browser.open(pages[name])
    assert browser.axe() == []


@needs_axe
def test_no_serious_fault_at_any_width(browser, pages, width):
    browser.open(pages["p45"])
    assert browser.axe() == []
    if width < 500:
        assert browser.js("return document.documentElement.scrollWidth") <= width
        assert 300 < browser.js("return document.getElementById('plot-map').clientWidth") <= width


def test_the_actuator_under_the_pointer_is_told_in_full(browser, pages, p45_findings):
    browser.open(pages["p45"])
    browser.pointer("map", 16)
    told = browser.wait(TOOLTIP)
    c = p45_findings.calibration
    assert "actuator17" in told.replace(": ", "").replace(" ", "")
    assert f"{c.alpha[16]:.3f}"[:4] in told
    assert f"{c.error[16]:.4f}"[:4] in told
    for name in ("ring", "x, y", "alpha", "statistical σ_stat (E_STAT)", "leverage", "residual"):
        assert name in told, name
    panel = browser.js("return document.getElementById('detail').textContent")
    assert "actuator17" in panel
    assert browser.js(SELECTED) == []  # pointing is not selecting


def test_what_is_selected_in_one_view_is_selected_in_all(browser, pages):
    browser.open(pages["p45"])
    before = browser.js(PICTURE, "rings")
    browser.pointer("map", 29, click=True)
    assert browser.wait(SELECTED) == [29]
    assert browser.js(MARKED) == [29]
    assert browser.js(PICTURE, "rings") != before
    map_before = browser.js(PICTURE, "map")
    browser.pointer("rings", 4, click=True)
    browser.wait(
        "return Bokeh.documents[0].get_model_by_name('actuators').selected.indices[0] === 4"
    )
    assert browser.js(MARKED) == [4]
    assert browser.js(PICTURE, "map") != map_before
    browser.js("document.querySelector('#actuators tbody tr[data-index=\"11\"]').click()")
    assert browser.js(SELECTED) == [11]
    browser.js("document.getElementById('clear').click()")
    assert browser.js(SELECTED) == []
    assert browser.js(MARKED) == []


def test_the_layers_colour_the_map(browser, pages, p45_findings):
    browser.open(pages["p45"])
    names = browser.js(
        "return [...document.querySelectorAll('#layers label')].map((l) => l.textContent.trim())"
    )
    assert {"alpha", "statistical σ_stat (E_STAT)", "leverage", "residual / noise"} <= set(names)
    seen = set()
    for k in range(len(names)):
        browser.js("document.querySelectorAll('#layers input')[arguments[0]].click()", k)
        seen.add(browser.js(PICTURE, "map"))
        shown = browser.js(
            "return [...Bokeh.documents[0].get_model_by_name('actuators').get_column('shown')]"
        )
        if names[k] == "leverage":
            assert shown == pytest.approx(p45_findings.calibration.diagnosis.leverage)
    assert len(seen) == len(names)


def search(browser, words):
    browser.js(
        "const box = document.getElementById('wanted'); box.value = arguments[0];"
        "box.dispatchEvent(new Event('input'))",
        words,
    )
    return browser.js(ROWS)


def test_the_table_filters_and_sorts(browser, pages, p45_findings):
    browser.open(pages["p45"])
    c = p45_findings.calibration
    assert search(browser, "3, 10-12") == ["3", "10", "11", "12"]
    low = [str(i) for i in c.layout.id[c.alpha < 0.8]]
    assert 2 < len(low) < 43
    assert search(browser, "alpha < 0.8") == low
    assert search(browser, "alpha<0.8 ring=2") == [i for i in low if 10 <= int(i) <= 24]
    assert search(browser, "nonsense") == []
    assert "not understood" in browser.js("return document.getElementById('count').textContent")
    search(browser, "")
    browser.js("document.querySelector('th[data-key=alpha] button').click()")
    assert browser.js(ROWS) == [str(i) for i in c.layout.id[np.argsort(c.alpha)]]
    browser.js("document.querySelector('th[data-key=alpha] button').click()")
    assert browser.js(ROWS)[0] == str(c.layout.id[c.alpha.argmax()])


def test_the_table_is_downloaded_as_csv(browser, pages, p45_findings, downloads):
    browser.open(pages["p45"])
    search(browser, "1-20")
    browser.js("document.getElementById('csv').click()")
    target = downloads / "actuators.csv"
    until = time.monotonic() + 10
    while not target.exists() and time.monotonic() < until:
        time.sleep(0.05)
    with target.open(newline="") as file:
        rows = list(csv.DictReader(file))
    c = p45_findings.calibration
    assert [int(row["ID"]) for row in rows] == list(range(1, 21))
    assert [float(row["ALPHA"]) for row in rows] == pytest.approx(c.alpha[:20], rel=1e-6)
    assert [float(row["E_STAT"]) for row in rows] == pytest.approx(
        c.statistical_error[:20], rel=1e-6
    )
    assert [float(row["X_mm"]) for row in rows] == pytest.approx(1e3 * c.layout.x[:20], abs=1e-4)
    assert {"NOISE_mN", "RING"} <= set(rows[0])


def test_all_of_it_can_be_reached_by_the_keyboard(browser, pages):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    browser.open(pages["p45"])
    reached = []
    for _ in range(150):
        ActionChains(browser.driver).send_keys(Keys.TAB).perform()
        reached.append(
            browser.js(
                "const e = document.activeElement;"
                "return e.id || e.name || (e.dataset.index ? 'row' : e.tagName)"
            )
        )
        if reached[-1] == "row":
            break
    assert reached[-1] == "row"
    assert {"layer", "which", "clear", "wanted", "only", "csv"} <= set(reached)
    ActionChains(browser.driver).send_keys(Keys.ARROW_DOWN, Keys.ARROW_DOWN, Keys.ENTER).perform()
    assert browser.js(SELECTED) == [2]
    assert "actuator3" in browser.js("return document.getElementById('detail').textContent")
    browser.js("document.querySelector('#layers input').focus()")
    ActionChains(browser.driver).send_keys(Keys.ARROW_DOWN).perform()
    assert "E_ALPHA" in browser.js("return document.getElementById('meaning').textContent")


def test_the_first_screen_holds_verdict_advice_and_map(browser, pages):
    browser.open(pages["p45"])
    low = browser.js(
        "return ['.verdict', '#plot-map'].map((name) =>"
        " document.querySelector(name).getBoundingClientRect().bottom)"
    )
    assert max(low) <= browser.js("return window.innerHeight")


@pytest.mark.parametrize("name", ["p45", "no_alpha", "change"])
def test_the_contents_lead_to_every_section(browser, pages, name):
    browser.open(pages[name])
    linked, titles = browser.js(
        "return [[...document.querySelectorAll('.contents a')].map((a) => a.hash.slice(1)),"
        " [...document.querySelectorAll('main h2')].map((h) => h.id)]"
    )
    assert linked == [title for title in titles if title != "title-detail"]


def test_a_table_says_that_it_scrolls_where_it_does(browser, pages, width):
    browser.open(pages["p45"])
    told = browser.js(
        "return [...document.querySelectorAll('.scroll')].map((box) =>"
        " [!box.previousElementSibling.hidden, box.scrollWidth > box.clientWidth + 1])"
    )
    assert all(says == does for says, does in told)
    assert any(says for says, _ in told) == (width < 500)


def test_paper_shows_the_figures_in_full(browser, pages):
    browser.open(pages["p45"])
    sheet = browser.driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    assert base64.b64decode(sheet["data"]).startswith(b"%PDF")
    stills = browser.js(
        "return [...document.querySelectorAll('.still')]"
        ".map((i) => [i.id, i.alt, i.src.slice(0, 22), i.naturalWidth])"
    )
    assert [name for name, *_ in stills] == ["still-map", "still-rings"]
    for name, words, start, width in stills:
        assert start == "data:image/png;base64,", name
        assert len(words) > 40, name
        assert width > 500, name


DRAWINGS = """
return [...document.querySelectorAll("svg[role=img]")].map((svg) => {
  const box = svg.getBoundingClientRect(), host = svg.parentElement.getBoundingClientRect();
  return [svg.parentElement.id, svg.computedName, box.width, box.height, box.left - host.left,
          host.right - box.right];
});
"""
NAMES = ["budget", "residuals", "singular-values", "balance", "modes", "turbulence", "dissipation",
         "times"]  # fmt: skip


def test_drawings_fill_their_place_and_are_named_by_their_captions(browser, pages, width):
    browser.open(pages["p45"])
    drawings = browser.js(DRAWINGS)
    assert [name for name, *_ in drawings] == [f"drawing-{name}" for name in NAMES]
    for name, _, wide, high, left, right in drawings:
        assert 300 < wide < 700, name
        assert 0.2 < high / wide < 1.1, name
        assert min(left, right) > -1, name
