"""What `info` says of data, also of those that give no alpha."""

from dataclasses import replace

import numpy as np

import truenewton as tn
from helpers.changed import p45, with_forces
from studies.matrices import measured_or_made, noisy, true_stiffness
from truenewton.calibration.summary import summary_rows
from truenewton.calibration.survey import survey
from truenewton.records.campaign import Campaign
from truenewton.rounding import percent


def test_of_rows_that_do_not_fit_it_is_said_what_the_files_contain_and_why_there_is_no_alpha():
    random = np.random.default_rng(1)
    wild = with_forces(p45(), lambda _, f: random.permutation(f))
    values, lines = survey(Campaign(tuple(wild)))
    assert str(values["verdict"].level) == "no alpha"
    assert values["loads"][1]["load"] == "ring"
    assert values["faults"][0]["remedy"]
    assert any(line.startswith("  alpha is not determined: ") for line in lines)


def test_a_file_with_fewer_rows_than_the_others_of_its_load_is_named():
    bare, *others = p45()
    columns = "time", "shape", "sign", "valid", "force", "temperature", "position"
    short = {name: getattr(bare, name)[:50] for name in columns}
    lines = survey(Campaign((replace(bare, **short), *others)))[1]
    of_load = {line.split()[1]: line for line in lines if line.startswith("  load ")}
    assert of_load["bare"].endswith(f" 2 cycles, 140 rows (only 50 in {bare.name})")
    assert of_load["ring"].endswith(" 2 cycles, 180 rows")


def test_a_matrix_by_reciprocity_has_its_symmetry_with_gains_and_its_halves():
    made = measured_or_made("p45")
    gains = 1.0 + 0.01 * np.random.default_rng(3).standard_normal(45)
    _, matrix = noisy(made, true_stiffness(made), 5, "equal", 1e-5)
    found = tn.calibrate(replace(matrix, stiffness=matrix.stiffness * gains), "reciprocity")
    rows = {name: (value, note) for name, value, note in summary_rows(found)}
    facts = found.matrix_facts
    assert facts.asymmetry > 3 * facts.asymmetry_with_alpha > 9 * facts.asymmetry_with_gains
    assert percent(facts.asymmetry_with_gains) in rows["asymmetry"][1]
    assert "largest: " in rows["halves of the modes"][1]
    assert facts.asymmetry_with_gains < 1e-3
