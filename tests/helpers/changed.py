"""Campaigns of P45 with something changed, and what every command says of them."""

import json
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import p45_bench
from truenewton.arrays import jsonable
from truenewton.bench.simulated.static import run_cycles
from truenewton.errors import TrueNewtonError, TrueNewtonWarning
from truenewton.records.campaign import Campaign
from truenewton.report.findings import investigate
from truenewton.report.verdict import headline_of


@cache
def p45_cycles(noise, count):
    return tuple(run_cycles(replace(p45_bench(), force_noise=noise), count))


def p45(noise=1e-3, count=2, **changes):
    """Return cycles of P45 under two loads, their keywords changed."""
    return [replace(cycle, **changes) for cycle in p45_cycles(noise, count)]


def with_forces(cycles, change):
    """Return cycles with (N, n) forces changed, by the index of the cycle and what they are."""
    return [replace(c, force=change(k, np.array(c.force))) for k, c in enumerate(cycles)]


def said(cycles, method="ml"):
    """Return level, first fault and remedy of what is said of cycles; a refusal has no level."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TrueNewtonWarning)
        try:
            verdict = tn.calibrate(Campaign(tuple(cycles)), method).verdict
        except TrueNewtonError as error:
            return None, error.fault, error.remedy
    return verdict.level, verdict.faults[0].fault, verdict.faults[0].remedy


def check_alike(inside, path, *options):
    """Check that info, calibrate, report and Python give one verdict, or one refusal.

    What `report` prints and puts on its page is `headline_of` what it finds.
    """
    out = inside.prints("info", path, *options, "--json")
    verdict = json.loads(out)["verdict"]
    faults = [each for each in verdict["findings"] if each["level"] != "sound"]
    fault, remedy = (faults[0]["fault"], faults[0]["remedy"]) if faults else ("", "")
    python = dict(zip(("method",), options[1:], strict=False)) if "--method" in options else {}
    python |= {"population": True} if "--population" in options else {}
    code, out, error = inside("calibrate", path, *options, "--json")
    page = headline_of(investigate(tn.read(path), **python))
    assert page.level == verdict["level"]
    assert [each.fault for each in page.advice[:1]] == ([fault] if fault else [])
    if verdict["level"] == "no alpha":
        with pytest.raises(TrueNewtonError) as refusal:
            tn.calibrate(tn.read(path), **python)
        assert (refusal.value.fault, refusal.value.remedy) == (fault, remedy)
        assert code == 2
        assert fault in error
        return
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = tn.calibrate(tn.read(path), **python)
    assert jsonable(made.verdict.as_values) == verdict
    if verdict["level"] == "rejected":
        assert code == 2
        assert f"rejected: {fault}; {remedy}" in error
        assert any("rejected" in str(one.message) for one in caught)
    else:
        assert code == 0
        assert json.loads(out)["verdict"] == verdict
