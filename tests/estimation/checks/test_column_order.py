"""What each row gets, for the least in all."""

import itertools

import numpy as np
import pytest

from truenewton.linalg import assignment


@pytest.mark.parametrize("n", [2, 4, 6])
def test_it_is_the_cheapest_of_all(n):
    random = np.random.default_rng(n)
    for cost in random.normal(size=(40, n, 6)):
        every = [cost[np.arange(n), order].sum() for order in itertools.permutations(range(6), n)]
        made = assignment(cost)
        assert len(set(made)) == n
        assert cost[np.arange(n), made].sum() == pytest.approx(min(every), abs=1e-12)
