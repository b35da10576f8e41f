"""Smooth motions: where they start and end, sway within its amplitude, calibration within the limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import UnknownNameError
from handover_ros.sim.calibration_motions import MOTIONS, calibration_duration, calibration_plan
from handover_ros.sim.person_motion import Movement, MovementSequence, Sway, WayPointPath, minimum_jerk
from handover_ros.sim.person_spec import ARM_JOINTS, ARM_SLICE, HANDS, load_person
from handover_ros.skeleton.prompts import MOTION_NAMES, REPETITIONS

PEOPLE = ("adult", "small", "tall", "restricted")


@given(st.floats(0.0, 1.0))
def test_minimum_jerk_is_symmetric(share):
    assert np.isclose(minimum_jerk(share) + minimum_jerk(1.0 - share), 1.0)
    assert minimum_jerk(-1.0) == 0.0
    assert minimum_jerk(2.0) == 1.0


@given(st.floats(-3.0, 3.0), st.floats(0.3, 3.0), st.floats(-2.0, 2.0))
def test_a_movement_keeps_its_first_velocity_and_ends_at_rest(target, duration, velocity):
    movement = Movement(1.0, duration, np.zeros(1), np.array([velocity]), np.array([target]))
    step = 1e-6
    assert np.isclose(movement.position(1.0)[0], 0.0)
    assert np.isclose((movement.position(1.0 + step)[0]) / step, velocity, atol=1e-3)
    end = movement.end_time
    assert np.isclose(movement.position(end)[0], target)
    assert abs(movement.position(end)[0] - movement.position(end - step)[0]) / step < 1e-3


@given(st.integers(0, 1000), st.integers(2, 8))
def test_a_path_passes_its_way_points_within_bounds(seed, count):
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, size=(count, 3))
    path = WayPointPath(0.0, 2.0, points, np.full(3, -1.0), np.full(3, 1.0))
    run = np.array([path.position(time) for time in np.linspace(0.0, 2.0, 2001)])
    assert np.allclose(run[[0, -1]], points[[0, -1]])
    assert np.all(np.abs(run) <= 1.0)
    assert all(np.linalg.norm(run - point, axis=1).min() < 0.03 for point in points)


@pytest.mark.parametrize("name", PEOPLE)
@given(seed=st.integers(0, 2**32 - 1), start=st.floats(0.0, 1e4))
@settings(max_examples=20, deadline=None)
def test_sway_is_smooth_and_within_its_amplitude(name, seed, start):
    person = load_person(name)
    sway = Sway(person, np.random.default_rng(seed))
    offsets = np.array([sway.offset(start + 0.01 * step) for step in range(300)])
    p, a = person.sway.position, person.sway.angle
    limit = np.array([p, p, p, a, a, a]) + 1e-12
    assert np.all(np.abs(offsets) <= limit)
    assert np.all(np.abs(np.diff(offsets, axis=0)) <= limit * 0.01 * 2.0 * np.pi / person.sway.period)


@pytest.mark.parametrize("name", PEOPLE)
def test_calibration_motions_cover_the_range_three_times_within_the_limits(name):
    person = load_person(name)
    total = 0.0
    for plan in calibration_plan(person):
        movement = MovementSequence(0.0, plan.times, plan.postures)
        run = np.array([movement.position(time) for time in np.arange(0.0, plan.duration + 0.01, 0.01)])
        assert np.all(run >= person.lower - 1e-9)
        assert np.all(run <= person.upper + 1e-9)
        assert np.allclose(run[[0, -1]], person.standing)
        total += plan.duration
        if plan.name not in ARM_JOINTS:
            continue
        for hand in HANDS:
            column = ARM_SLICE[hand].start + ARM_JOINTS.index(plan.name)
            angle, width = run[:, column], person.upper[column] - person.lower[column]
            assert np.ptp(angle) > 0.95 * width
            high = angle > person.upper[column] - 0.05 * width
            assert np.sum(np.diff(high.astype(int)) == 1) == REPETITIONS
    assert np.isclose(total, calibration_duration(person))
    assert total < 120.0


def test_one_motion_can_be_picked_and_an_unknown_one_is_named():
    person = load_person("adult")
    assert [plan.name for plan in calibration_plan(person, "elbow_flexion")] == ["elbow_flexion"]
    assert set(ARM_JOINTS) < set(MOTION_NAMES)
    assert set(MOTIONS) == set(MOTION_NAMES), "the simulated person can do all that it may be asked to do"
    with pytest.raises(UnknownNameError, match="elbow_flexion"):
        calibration_plan(person, "somersault")
