"""Information of many small menus against its definition."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_people import neutral_space, weight_space

from handover_ros.errors import BadRequestError
from handover_ros.preferences.menu_kernels import log_from_one
from handover_ros.preferences.menus import information_of_menus
from handover_ros.preferences.query import Query
from handover_ros.preferences.reference import plain_information


@given(st.floats(1.0, 1e300))
def test_logarithm_is_exact_to_the_last_bits(x):
    assert log_from_one(x) == pytest.approx(np.log(x), rel=1e-15, abs=4e-16)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 4), st.sampled_from([neutral_space(), weight_space()]))
def test_information_of_each_menu_is_its_definition(seed, size, space):
    rng = np.random.default_rng(seed)
    people, weights = space.people(rng.uniform(*space.bounds, (20, 2))), rng.dirichlet(np.ones(20))
    items = rng.uniform(-2.0, 2.0, (9, 2))
    menus = np.array([rng.choice(9, size, replace=False) for _ in range(7)])
    found = information_of_menus(people, weights, items, menus)
    for menu, information in zip(menus, found):
        query = Query(items[menu], np.ones(size), np.zeros(size), ("any",))
        assert information == pytest.approx(plain_information(people, weights.tolist(), query), abs=1e-9)


@pytest.mark.parametrize("menus", [np.empty((0, 2), dtype=int), np.array([[0, 5]]), np.array([[-1, 0]]), np.arange(3)])
def test_menus_of_items_that_are_not_there_are_refused(menus):
    space = neutral_space()
    people = space.people(np.zeros((3, 2)))
    with pytest.raises(BadRequestError, match="menus"):
        information_of_menus(people, np.full(3, 1.0 / 3.0), np.zeros((5, 2)), menus)
