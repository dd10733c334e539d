"""The figures show what they should, in files a journal takes."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image

import truenewton as tn
from helpers.balanced import campaign_of
from helpers.segmented import in_one, pieces
from truenewton.calibration.figures import write_figures
from truenewton.calibration.methods import calibrate
from truenewton.errors import OutputExists, UnknownName
from truenewton.figures.layers import Layer
from truenewton.figures.maps import (
    bears_names,
    dot_radius,
    mark_rings,
    names_by_ring,
    numbers_by_ring,
    plot_layout,
    segment_places,
)
from truenewton.figures.style import ALARM, COLUMN
from truenewton.mirrors.known import p45
from truenewton.mirrors.segmented import gmt
from truenewton.statics.layout import layout, ring_centre, ring_of, rings


@pytest.fixture
def calibration(p45_calibration):
    return p45_calibration


def dots(ax):
    return [c for c in ax.collections if isinstance(c, PatchCollection) and len(c.get_paths())]


def test_the_map_shows_every_alpha_once_at_its_place(calibration):
    ax = calibration.plot()
    [shown] = dots(ax)
    assert np.array_equal(shown.get_array(), calibration.alpha)
    centres = np.array([path.vertices.mean(axis=0) for path in shown.get_paths()])
    places = 1e3 * np.stack([calibration.layout.x, calibration.layout.y], axis=1)
    assert np.abs(centres - places).max() < 2.0  # millimetres
    assert {text.get_text() for text in ax.texts} >= {str(k) for k in range(1, 46)}


def test_a_disabled_actuator_is_an_open_circle():
    calibration = calibrate(campaign_of(seed=1, noise=1e-4, disabled=(4,))[0])
    open_circles, shown = dots(calibration.plot())
    assert len(open_circles.get_paths()) == 1
    assert len(shown.get_paths()) == calibration.layout.n - 1


def test_alpha_stands_ring_by_ring_with_three_sigma_bars_that_can_be_seen(calibration):
    ax = replace(calibration, statistical_error=1e-4 * calibration.alpha).plot_actuators()
    assert ax.lines[0].get_ydata() == pytest.approx(calibration.alpha, rel=1e-15)
    assert not ax.containers
    [legend] = ax.get_legend().get_texts()
    assert legend.get_text() == "α; bars of ±3 σ_stat would be smaller than the symbols"
    large = replace(calibration, statistical_error=0.01 * calibration.alpha)
    [bars] = large.plot_actuators().containers
    ends = np.array([s[:, 1] for s in bars.lines[2][0].get_segments()])
    half = 0.5 * (ends[:, 1] - ends[:, 0])
    assert half == pytest.approx(0.03 * calibration.alpha, rel=1e-9)
    named = {text.get_text() for text in ax.texts}
    extremes = {str(calibration.alpha.argmin() + 1), str(calibration.alpha.argmax() + 1)}
    assert named == {"ring 1", "ring 2", "ring 3"} | extremes


def test_a_segment_beside_the_axis_has_its_own_rings_and_its_own_ids():
    """Ring by ring about its middle; ticks name the actuators, not their places on the axis."""
    one = rings([0.04, 0.07], [9, 15])
    away = layout(one.x + 0.3, one.y - 0.2, id=np.arange(24, 0, -1) + 100)
    assert np.array_equal(ring_of(away), ring_of(one))
    assert ring_centre(away) == pytest.approx((0.3, -0.2))
    assert (ring_centre(one), names_by_ring(one)) == ((0.0, 0.0), {})
    ax = Figure().add_subplot()
    ax.plot(numbers_by_ring(away), away.x)
    mark_rings(ax, away)
    written = ax.xaxis.get_major_formatter()
    assert [written(place, None) for place in (0, 1, 9, 24, 25)] == ["", "124", "116", "101", ""]


def test_the_errors_have_a_panel_of_their_own_in_per_cent_of_alpha(calibration):
    c, ax = calibration, calibration.plot_actuators()
    _, below = ax.figure.axes
    assert below.get_yscale() == "log"
    drawn = {line.get_label(): line for line in below.lines}
    for name, error in (("σ_stat", c.statistical_error), ("σ_scale", c.systematic_error),
                        ("σ_cycle = E_CYCLE / 3", c.cycle_error / 3)):  # fmt: skip
        assert drawn[name].get_xdata() == pytest.approx(np.arange(1, 46))
        assert drawn[name].get_ydata() == pytest.approx(100 * error / c.alpha)
    given = Figure().add_subplot()
    calibration.plot_actuators(given)
    assert given.figure.axes == [given]


def test_every_quantity_has_a_map_with_the_colours_that_are_asked_for(calibration):
    ax = calibration.plot("e_stat", cmap="viridis", vmin=0.0, vmax=1e-3)
    [shown] = dots(ax)
    assert np.array_equal(shown.get_array(), calibration.statistical_error)
    assert (shown.get_cmap().name, shown.get_clim()) == ("viridis", (0.0, 1e-3))
    assert {"z, seen along -z", "ring "} <= {text.get_text() for text in ax.texts}
    [shown] = dots(calibration.plot())  # colours are centred on the mean
    assert np.mean(shown.get_clim()) == pytest.approx(np.mean(calibration.alpha))
    with pytest.raises(UnknownName, match="choose alpha, e_alpha, e_stat"):
        calibration.plot("colour")


def test_outliers_of_a_large_mirror_are_named_beside_its_map_and_rings_are_ticks():
    large = rings(np.linspace(0.03, 0.3, 10), [12 + 5 * k for k in range(10)])
    values = 1.0 + 0.01 * np.random.default_rng(1).standard_normal(large.n)
    values[[16, 200]] = 1.3, 0.5
    layer = Layer("alpha", "alpha", "N/N", values, "", centre=1.0)
    ax = layer.plot(large)
    assert {"17", "201"} == {text.get_text() for text in ax.texts if text.get_color() == ALARM}
    assert "Beyond the ends: " in ax.figure.axes[1].get_xlabel()
    ax = Figure().add_subplot()
    mark_rings(ax, large)
    assert [text.get_text() for text in ax.get_xticklabels()] == [str(k) for k in range(1, 11)]


def test_alpha_stands_in_the_map_as_a_number_where_asked(calibration):
    ax = calibration.plot(annotate=True)
    told = [text.get_text().split("\n") for text in ax.texts if "\n" in text.get_text()]
    assert [int(name) for name, _ in told] == calibration.layout.id.tolist()
    assert [float(value) for _, value in told] == pytest.approx(calibration.alpha, abs=0.0051)


def test_figures_2_5_and_6_as_pdf_and_png_at_column_width(calibration, tmp_path):
    paths = write_figures(calibration, tmp_path / "figures")
    names = {path.name for path in paths}
    stems = ("fig2-actuators", "fig5-alpha", "fig6-alpha-map")
    assert names == {f"{stem}.{form}" for stem in stems for form in ("pdf", "png")}
    for path in paths:
        if path.suffix == ".pdf":
            written = path.read_bytes()
            assert written.startswith(b"%PDF")
            assert b"/CIDFontType2" in written  # TrueType, as journals take it
            assert b"/Type3" not in written
        else:
            with Image.open(path) as image:
                assert image.width == pytest.approx(COLUMN * 300, abs=2)
                assert len(image.convert("L").getcolors()) > 50  # not an empty page
    with pytest.raises(OutputExists):
        write_figures(calibration, tmp_path / "figures")


def test_fonts_are_truetype_where_the_user_saves(calibration, tmp_path):
    before = matplotlib.rcParams["pdf.fonttype"]
    for name, ax in (("own", plot_layout(calibration.layout)),
                     ("pyplot", calibration.plot())):  # fmt: skip
        ax.figure.savefig(tmp_path / f"{name}.pdf")
        written = (tmp_path / f"{name}.pdf").read_bytes()
        assert b"/CIDFontType2" in written
        assert b"/Type3" not in written
    assert matplotlib.rcParams["pdf.fonttype"] == before == 3


def test_fig_2_shows_the_edges_of_the_glass_where_they_are_known():
    mirror = p45()
    ax = plot_layout(mirror.layout, edges=mirror.shell.seen_edges())
    radii = {round(float(np.hypot(*patch.get_xy().T).max()), 2)
             for patch in ax.patches if isinstance(patch, Polygon)}  # fmt: skip
    # r along the glass is R sin(r / R) from the axis.
    assert radii == {round(1955.0 * np.sin(r / 1955.0), 2) for r in (27.5, 120.005)}
    assert ax.get_xlim()[1] > 120.0


@pytest.mark.study
def test_the_same_calibration_draws_the_same_bytes(calibration, tmp_path):
    one, two = (write_figures(calibration, tmp_path / name) for name in ("one", "two"))
    assert [p.read_bytes() for p in one] == [p.read_bytes() for p in two]


def test_segments_are_named_beside_their_actuators():
    """No dot is hidden, and the nearest is one of their own; the middle one's has no hole."""
    whole = in_one(pieces(3)[0])[0].layout
    wall = replace(whole, x=whole.x - whole.x[whole.segment == 1].mean())
    for some in (gmt().layout, whole, wall):
        places = segment_places(some)
        assert [number for number, _, _ in places] == list(some.segments)
        for number, x, y in places:
            own = some.segment == number
            near = np.hypot(1e3 * some.x - x, 1e3 * some.y - y)
            assert near.min() > 2 * dot_radius(some)
            assert own[near.argmin()]
    assert segment_places(whole.part(whole.in_segment(1))) == []
    one = p45().layout  # of two of them far apart dots are too small for names
    two = tn.layout(np.append(one.x, one.x + 0.5), np.tile(one.y, 2), segment=np.repeat([1, 2], 45))
    assert [bears_names(some) for some in (one, two)] == [True, False]
