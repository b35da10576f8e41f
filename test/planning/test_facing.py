"""How objects are turned to the person."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.objects import load_catalogue, load_object
from handover_ros.planning.facing import LEAST_HORIZONTAL, facings, object_centre, turned_object

CATALOGUE = load_catalogue()
YAWS = st.floats(-np.pi, np.pi)


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_the_palm_comes_along_the_reach(name):
    """Turned by its yaw from the person's reach, the palm's approach points along that reach (one hand)."""
    model = CATALOGUE[name]
    if model.hands == 2:
        return
    for facing in facings(model):
        palm = (turned_object(model, np.zeros(3), facing.yaw) @ facing.object_from_hand)[:3, 2]
        assert palm[0] >= LEAST_HORIZONTAL - 1e-9
        assert abs(palm[1]) < 1e-9


def test_mug_offers_its_handle_first():
    assert facings(load_object("mug"))[0].region.startswith("handle")


def test_two_hands_come_from_both_sides():
    """The two ends of the box lie left and right of the person's reach."""
    box = load_object("box")
    left, right = (region.centre()[:3, 3] for region in box.human_grasps[:2])
    for facing in facings(box):
        line = turned_object(box, np.zeros(3), facing.yaw)[:3, :3] @ (left - right)
        assert abs(line[0]) < 1e-9
        assert abs(line[1]) > 0.1


def test_a_glass_can_be_turned_all_round():
    assert len(facings(load_object("glass"))) >= 8


@given(st.sampled_from(sorted(CATALOGUE)), YAWS, st.floats(0.0, 1.2), YAWS)
@settings(deadline=None, max_examples=40)
def test_the_centre_stays_where_it_is_put(name, yaw, tilt, heading):
    """Turning and tilting happen about the object's centre; the top leans by the tilt to the given side."""
    model = CATALOGUE[name]
    towards = np.array([np.cos(heading), np.sin(heading), 0.0])
    pose = turned_object(model, np.array([1.0, 2.0, 3.0]), yaw, tilt, towards)
    np.testing.assert_allclose(pose[:3, :3] @ object_centre(model) + pose[:3, 3], [1.0, 2.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 2], np.cos(tilt) * np.array([0, 0, 1.0]) + np.sin(tilt) * towards, atol=1e-12)


def test_centre_of_a_simple_object():
    """The plate's centre is in its middle, as its file says."""
    np.testing.assert_allclose(object_centre(load_object("plate")), [0.0, 0.0, 0.1087], atol=1e-3)
