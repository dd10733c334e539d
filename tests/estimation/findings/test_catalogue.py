"""The catalogue of findings, and the findings that calibration files contain."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from truenewton.estimation.findings.catalogue import ENTRIES
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding

SOURCE = Path(tn.__file__).parent


EFFECTS = [code for code in Code if ENTRIES[code].name]


def test_every_code_has_one_entry_and_a_name_or_a_sentence():
    assert set(ENTRIES) == set(Code)
    assert len({entry.name for entry in ENTRIES.values() if entry.name}) == len(EFFECTS)
    assert all(entry.name or entry.sentence for entry in ENTRIES.values())


def test_no_control_flow_depends_on_the_name_of_a_finding():
    """Names are only printed; decisions depend on codes."""
    compared = re.compile(r"(effect|finding|each|e|one)\.name( ==| in |\.startswith|\.endswith)")
    found = [
        f"{path.name}: {line.strip()}"
        for path in SOURCE.rglob("*.py")
        if "estimation" in path.parts or "calibration" in path.parts or "modal" in path.parts
        for line in path.read_text(encoding="utf-8").splitlines()
        if compared.search(line)
    ]
    assert found == []


@pytest.fixture
def found():
    return (
        Finding(code=Code.EXCHANGED_COLUMNS, detail="FORCE", where="actuators 3, 17", size=0.1,
                actuators=(3, 17), unit="m", remedy="put the cables in order"),
        Finding(code=Code.STUCK_READING, where="actuator 5", actuators=(5,), remedy="look at it"),
        Finding(code=Code.GAIN_BY_HOUR, probability=1e-9, size=0.01, unit="1/h", corrected=True,
                remedy="let it warm up"),
    )  # fmt: skip


def test_findings_are_read_from_a_file(p45_calibration, found, tmp_path):
    path = tmp_path / "alpha.fits"
    replace(p45_calibration, effects=found).write(path)
    assert tn.read(path).effects == found


def test_an_unknown_code_of_a_newer_version_keeps_name_and_level(p45_calibration, found, tmp_path):
    path = tmp_path / "alpha.fits"
    replace(p45_calibration, effects=found).write(path)
    with fits.open(path) as hdus:
        hdus["EFFECTS"].data["CODE"] = "a-newer-one"
        hdus.writeto(path, overwrite=True, checksum=True)
    newer = tn.read(path).effects
    assert {each.code for each in newer} == {Code.OTHER}
    assert [each.name for each in newer] == [each.name for each in found]
    assert [each.level for each in newer] == [each.level for each in found]
    assert {each.level for each in newer} == {tn.Level.REJECTED, tn.Level.USABLE}


def test_levels_are_ordered():
    assert sorted(tn.Level) == list(tn.Level)
    assert tn.Level.DOUBTFUL < tn.Level.USABLE <= tn.Level.SOUND > "rejected"


def test_a_corrected_effect_is_usable_and_an_uncorrected_one_is_not():
    left_in = Finding(code=Code.GAIN_BY_HOUR, remedy="let it warm up")
    assert left_in.level is tn.Level.DOUBTFUL
    assert replace(left_in, corrected=True).level is tn.Level.USABLE


WARNINGS = (
    Finding.of(Code.WEIGHTS_DISAGREE, loads=np.int64(3), sigmas=np.float64(4.2)),
    Finding.of(Code.RECIPROCITY_EXCLUDED, actuators=[3, 17]),
    Finding.of(Code.RECIPROCITY_NOT_USED,
               cause=Finding.of(Code.ERRORS_LARGER, error=0.025, of_balance=0.001)),
    Finding.of(Code.MISFIT_EXPLAINED),
)  # fmt: skip


def test_warnings_are_read_with_their_values_and_cause(p45_calibration, tmp_path):
    path, newer = tmp_path / "alpha.fits", tmp_path / "newer.fits"
    diagnosis = replace(p45_calibration.diagnosis, warnings=WARNINGS)
    replace(p45_calibration, diagnosis=diagnosis).write(path)
    read = tn.read(path).diagnosis.warnings
    assert read == WARNINGS
    assert [each.level for each in read] == ["doubtful", "usable", "sound", "doubtful"]
    with fits.open(path) as hdus:
        hdus["WARNINGS"].data["CODE"][:2] = "a-newer-one"
        hdus.writeto(newer, checksum=True)
    read = tn.read(newer).diagnosis.warnings
    assert [each.code for each in read[:2]] == [Code.OTHER] * 2
    assert [each.fault for each in read] == [each.fault for each in WARNINGS]
    assert [each.level for each in read] == ["doubtful", "usable", "sound", "doubtful"]
