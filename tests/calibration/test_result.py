"""Using a calibration in Python, as a user does."""

import numpy as np
import pytest

from truenewton.errors import UnknownName


def test_forces_are_converted_both_ways(p45_calibration):
    c = p45_calibration
    commanded = np.linspace(-0.1, 0.1, 90).reshape(2, 45)
    assert np.allclose(c.to_true(commanded), commanded * c.alpha)
    assert np.allclose(c.to_commanded(c.to_true(commanded)), commanded)
    k = np.diag(1.0 / c.alpha) @ np.ones((45, 45))
    assert np.allclose(c.true_stiffness(k), 1.0)


def test_alpha_of_ids(p45_calibration):
    c = p45_calibration
    assert len(c) == 45
    assert np.array_equal(c.alpha_of([17, 3]), [c.alpha[16], c.alpha[2]])
    with pytest.raises(UnknownName, match="there is no actuators 0 and 46"):
        c.alpha_of([0, 17, 46])


def test_an_actuator_is_a_row_of_the_table_by_its_id(p45_calibration):
    c = p45_calibration
    one = c[17]
    assert (one["ID"], one["ALPHA"].value) == (17, c.alpha[16])
    assert one["X"].unit == "m"
    assert 17 in c
    assert 46 not in c
    assert list(c) == c.layout.id.tolist()
    with pytest.raises(UnknownName, match="there is no actuator 46; IDs run"):
        c[46]


def test_the_summary_is_that_of_the_terminal(p45_calibration):
    text = p45_calibration.summary()
    assert text.startswith("P45")
    assert "typical error of alpha" in text
    assert f"verdict                 {p45_calibration.verdict.level}" in text


def test_a_pandas_table_has_the_ids_as_index(p45_calibration):
    frame = p45_calibration.to_pandas()
    assert frame.loc[17, "ALPHA"] == p45_calibration.alpha[16]
