"""Campaigns from arrays and long tables are those of the same cycles."""

import astropy.units as u
import numpy as np
import pandas as pd
import pytest

import truenewton as tn
from helpers.balanced import campaign_of
from truenewton.errors import FormatError

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
    wrong = {RING: [{**LOADS[RING][0], "forces": 0}]}
    with pytest.raises(FormatError, match="load 'ring', cycle 1: 'forces' is unknown; choose time"):
        tn.Campaign.from_arrays("TEST", LAYOUT, *WEIGHTS, wrong)


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


def long_table():
    """Every reading in a row of its own, in no order."""
    parts = []
    for cycle in CAMPAIGN:
        row, actuator = np.indices(cycle.force.shape).reshape(2, -1)
        parts.append(
            pd.DataFrame({
                "load": cycle.load.name.upper(), "cycle": cycle.number, "sign": cycle.sign[row],
                "mode": cycle.shape[row], "actuator": LAYOUT.id[actuator],
                "mN": 1e3 * cycle.force[row, actuator], "time": cycle.time[row],
            })
        )  # fmt: skip
    return pd.concat(parts).sample(frac=1.0, random_state=1)


NAMES = {"columns": {"shape": "mode", "force": "mN"}, "units": {"force": "mN"}}


def test_a_long_table_makes_a_campaign():
    made = tn.Campaign.from_dataframe(long_table(), "TEST", LAYOUT, *WEIGHTS, [BARE, RING], **NAMES)
    for one, other in zip(made, CAMPAIGN, strict=True):
        order = np.argsort(one.time)
        assert np.array_equal(one.shape[order], other.shape)
        np.testing.assert_allclose(one.force[order], other.force, rtol=1e-14)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.rename(columns={"mode": "m"}), "no column 'mode'; name it by columns"),
        (lambda t: t.replace("RING", "disc"), "the table has the load 'disc'; give it in loads"),
        (lambda t: t[t.load != "RING"], "no row of the load 'ring'"),
        (lambda t: t.replace({"actuator": {3: 99}}), "cycle 1: there is no actuator 99"),
        (lambda t: pd.concat([t, t.iloc[:1]]), "has two readings of shape .*; add a column 'row'"),
    ],
)
def test_what_is_wrong_with_a_table_is_said_in_one_line(change, words):
    with pytest.raises(FormatError, match=words):
        tn.Campaign.from_dataframe(
            change(long_table()), "TEST", LAYOUT, *WEIGHTS, [BARE, RING], **NAMES
        )
