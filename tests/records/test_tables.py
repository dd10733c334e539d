"""Campaigns from arrays and long tables are those of the same cycles."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pandas as pd
import pytest

import truenewton as tn
from helpers.balanced import campaign_of
from truenewton.errors import CampaignMismatch, FormatError, GeometryError, SeveralSegments

CAMPAIGN = campaign_of(seed=3, noise=1e-4, disabled=(5,))[0]
LAYOUT = CAMPAIGN.layout
BARE, RING = CAMPAIGN.loads
WEIGHTS = (CAMPAIGN.weight, CAMPAIGN.weight_error)


def arrays(load):
    return [
        {"force": c.force, "shape": c.shape, "sign": c.sign}
        for c in CAMPAIGN
        if c.load.key == load.key
    ]


LOADS = {BARE: arrays(BARE), RING: arrays(RING)}


def test_arrays_make_a_campaign():
    made = tn.Campaign.from_arrays("TEST", LAYOUT, *WEIGHTS, LOADS, force_error=1e-4)
    alpha = tn.calibrate(CAMPAIGN).alpha
    np.testing.assert_allclose(tn.calibrate(made).alpha, alpha, rtol=1e-6)
    dates = [cycle.date for cycle in made]
    assert dates == sorted(set(dates))  # one after the other


@pytest.mark.parametrize(
    ("loads", "words"),
    [
        ({RING: [{**LOADS[RING][0], "forces": 0}]}, "ring', cycle 1: 'forces' is unknown; choose"),
        (
            {"ring": LOADS[RING]},
            r"names 'ring' without its added weight; give tn.Load\('ring', added, added_e",
        ),
        ([RING], "loads is no dictionary; give {load: .cycle, "),
        ({RING: [(1, 2)]}, "a cycle of load 'ring' is <class 'tuple'>; give a dictionary"),
    ],
)
def test_what_is_wrong_with_arrays_is_said_in_one_line(loads, words):
    with pytest.raises(FormatError, match=words):
        tn.Campaign.from_arrays("TEST", LAYOUT, *WEIGHTS, loads)


def test_pandas_with_units_and_positions_of_each_actuator_in_a_row():
    """A pandas table keeps its unit if it is multiplied by one, a column loses it: units."""
    places = pd.DataFrame({"x": LAYOUT.x, "y": LAYOUT.y}) * 1e3
    run, other = LOADS[BARE][0], {"enabled": LAYOUT.enabled}
    force = pd.DataFrame(1e3 * run["force"])
    of_units = {"force": "mN", "positions": "mm"}
    plain = tn.Campaign.from_arrays("T", places, *WEIGHTS, {BARE: {**run, "force": force}},
                                    units=of_units, **other)  # fmt: skip
    with_unit = tn.Campaign.from_arrays(
        "T", places * u.mm, *WEIGHTS, {BARE: {**run, "force": force * u.mN}}, **other
    )
    for made in (plain, with_unit):
        np.testing.assert_allclose(made.cycles[0].force, run["force"], rtol=1e-12)
        np.testing.assert_allclose(made.layout.y, LAYOUT.y, rtol=1e-12)
    with pytest.raises(GeometryError, match=r"are up to 0\.1 mm from the axis, and the mirror"):
        tn.Campaign.from_arrays(
            "T", places, *WEIGHTS, {BARE: run}, **other, units={"positions": "um"}
        )


def test_segments_are_campaigns_of_their_own():
    part = replace(LAYOUT, segment=1 + (LAYOUT.id > 7))
    with pytest.raises(
        CampaignMismatch, match=r"layout has 2 segments, .*; make a campaign of each"
    ):
        tn.Campaign.from_arrays("TEST", part, *WEIGHTS, LOADS)
    cycles = []
    for k in (1, 2):
        own = part.segment == k
        runs = [{**run, "force": run["force"][:, own]} for run in LOADS[BARE]]
        cycles += tn.Campaign.from_arrays("TEST", part.part(own), *WEIGHTS, {BARE: runs})
    with pytest.raises(SeveralSegments, match="segments 1, 2"):
        tn.calibrate(cycles)


def test_weights_may_be_masses_and_have_a_sign():
    load = tn.Load("ring", added=45 * u.g, added_error=0.1 * u.g)
    assert (load.added, load.added_error) == pytest.approx((-0.045 * 9.80665, 1e-4 * 9.80665))
    xy = (LAYOUT.x * 1e3 * u.mm, LAYOUT.y)
    made = tn.Campaign.from_arrays("TEST", xy, 0.3 * u.kg, 1 * u.g, {load: LOADS[RING]},
                                   enabled=LAYOUT.enabled)  # fmt: skip
    assert made.weight == pytest.approx(-0.3 * 9.80665)
    for added in (0.289, -45 * u.g):
        with pytest.raises(FormatError, match=r"ADDED is 0\.\d+ N; z points up"):
            tn.Load("ring", added)
    # A bare error is in N only if the weight is a force, or the error 0.
    assert tn.Load("ring", -0.3, 0.2).added_error == 0.2
    assert tn.Load("ring", "-0.3 N", 0.2).added_error == 0.2
    assert tn.Load("ring", "30 g", 0.0).added_error == 0.0
    for added in ("30 g", 30 * u.g):
        with pytest.raises(FormatError, match=r"'ring': added_error is 0.2 without .*'0\.2 g'"):
            tn.Load("ring", added, 0.2)
    with pytest.raises(FormatError, match=r"weight_error is 0\.5 without a unit, but weight is a"):
        tn.Campaign.from_arrays("TEST", xy, "300 g", 0.5, {load: LOADS[RING]},
                                enabled=LAYOUT.enabled)  # fmt: skip


def test_a_table_of_all_cycles_is_divided_by_load_and_cycle():
    """As on the page of the files: F1, F2, ... of one reading in a row, IDs that are texts."""
    names = np.array([f"{'AB'[int(i > 5)]}{i}" for i in LAYOUT.id])
    places = pd.DataFrame({"id": names, "x [mm]": 1e3 * LAYOUT.x, "y [mm]": 1e3 * LAYOUT.y})
    places["nz"] = LAYOUT.nz
    parts = []
    for c in CAMPAIGN:
        forces = pd.DataFrame(1e3 * c.force, columns=[f"F{i}" for i in LAYOUT.id])
        parts.append(forces.assign(load=c.load.name, cycle=c.number, shape=c.shape, sign=c.sign))
    loads = {BARE.name: BARE, RING.name: RING}
    runs = {load: [] for load in loads.values()}
    for (name, cycle), rows in pd.concat(parts).groupby(["load", "cycle"]):
        run = {"number": cycle, "force": rows.filter(regex=r"^F\d")}
        runs[loads[name]].append(run | {"shape": rows["shape"], "sign": rows["sign"]})
    made = tn.Campaign.from_arrays(
        "TEST", places, *WEIGHTS, runs, units={"force": "mN"}, enabled=LAYOUT.enabled
    )
    assert made.layout.same_as(LAYOUT)
    assert made.layout.names.tolist() == names.tolist()
    for one, other in zip(made, CAMPAIGN, strict=True):
        assert (one.load.name, one.number) == (other.load.name, other.number)
        np.testing.assert_allclose(one.force, other.force, rtol=1e-14)
    with pytest.raises(FormatError, match=r"POSITIONS is not numbers .*'A1'"):
        tn.Campaign.from_arrays("T", places.to_numpy()[:, :2], *WEIGHTS, LOADS,
                                units={"positions": "mm"})  # fmt: skip


def test_columns_of_pandas_in_the_order_of_texts_are_refused():
    run = LOADS[BARE][0]
    named = pd.DataFrame(run["force"], columns=[f"F{i}" for i in LAYOUT.id])
    given = "TEST", LAYOUT, *WEIGHTS
    tn.Campaign.from_arrays(*given, {BARE: {**run, "force": named}})
    with pytest.raises(FormatError, match="columns are in the order F1, F10, F11, F12 and 10 more"):
        tn.Campaign.from_arrays(*given, {BARE: {**run, "force": named[sorted(named.columns)]}})


def test_times_are_assumed_only_where_none_is_given():
    run, date = LOADS[BARE][0], CAMPAIGN.cycles[0].date
    time = np.arange(len(run["shape"]), dtype=float)
    dates = np.datetime64("2026-11-21T09:30") + time.astype("timedelta64[s]")
    for more, given, times in (
        ({}, None, "assumed"),
        ({}, date, "assumed"),
        ({"time": time}, None, "assumed"),
        ({"time": time}, date, None),
        ({"time": time, "date": date}, None, None),
        ({"time": dates}, None, None),
    ):
        made = tn.Campaign.from_arrays("T", LAYOUT, *WEIGHTS, {BARE: {**run, **more}}, date=given)
        assert made.cycles[0].times == times
