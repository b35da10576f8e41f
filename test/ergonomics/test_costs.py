"""Costs of a posture."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pendulum import pendulum

from handover_ros.arm.hand import hand_frames
from handover_ros.ergonomics.costs import (
    COSTS,
    MinimumJerk,
    MinimumTorqueChange,
    MinimumWork,
    PreferredPosture,
    cost_gradient,
    load_cost,
)
from handover_ros.ergonomics.dynamics import BodyDynamics
from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.jacobian import WORLD_FRAME, Frame, relative_pose
from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton

PERSON = load_person("adult")
SKELETON = skeleton_of(PERSON)
DYNAMICS = BodyDynamics(SKELETON, PERSON.mass)
seeds = st.integers(0, 10**6)
FINE = 2000


def postures(seed, *shape):
    return np.random.default_rng(seed).uniform(SKELETON.lower, SKELETON.upper, (*shape, len(SKELETON.lower)))


def plain_reach(start, end, duration):
    """Return times and displacements of a reach on a fine grid."""
    s = np.linspace(0.0, 1.0, FINE + 1)
    return duration * s, start + (end - start) * (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None]


def rate(values, time):
    return np.gradient(values, time, axis=0, edge_order=2)


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(sorted(COSTS)), seeds)
def test_many_ends_are_each_alone_and_no_cost_is_negative(name, seed):
    cost = load_cost(name, SKELETON, PERSON.mass)
    start, ends = postures(seed), postures(seed + 1, 2, 3)
    many = cost.evaluate(start, ends)
    assert many.shape == (2, 3)
    assert (many >= 0.0).all()
    for index in np.ndindex(2, 3):
        assert cost.evaluate(start, ends[index]) == pytest.approx(many[index], rel=1e-9)


@pytest.mark.parametrize("name", ["minimum_work", "minimum_torque_change", "minimum_jerk"])
def test_staying_costs_nothing(name):
    cost = load_cost(name, SKELETON, PERSON.mass)
    start = postures(3)
    assert cost.evaluate(start, start) == pytest.approx(0.0, abs=1e-9)


@given(seeds)
def test_preferred_posture_is_the_middle_of_the_limits(seed):
    cost = PreferredPosture(SKELETON)
    middle = 0.5 * (SKELETON.lower + SKELETON.upper)
    end = postures(seed)
    assert cost.evaluate(np.zeros(14), middle) == 0.0
    assert cost.evaluate(np.zeros(14), end) == pytest.approx(np.linalg.norm(end - middle))
    np.testing.assert_allclose(
        cost_gradient(cost, np.zeros(14), end), (end - middle) / np.linalg.norm(end - middle), atol=1e-8
    )


def test_preferred_posture_with_weights():
    weights = np.zeros(14)
    weights[3] = 4.0
    cost = PreferredPosture(SKELETON, preferred=np.zeros(14), weights=weights)
    assert cost.evaluate(np.zeros(14), np.ones(14)) == pytest.approx(2.0)
    with pytest.raises(BadRequestError, match="negative"):
        PreferredPosture(SKELETON, weights=-weights)
    with pytest.raises(BadRequestError, match="14 finite"):
        PreferredPosture(SKELETON, preferred=[0.0])


@settings(max_examples=8, deadline=None)
@given(seeds)
def test_work_equals_a_plain_loop(seed):
    start, end = postures(seed), postures(seed + 1)
    time, path = plain_reach(start, end, 1.1)
    rates = rate(path, time)
    torques = DYNAMICS.inverse_dynamics(path, rates, rate(rates, time))
    expected = np.trapezoid(np.maximum(torques * rates, 0.0).sum(axis=1), time)
    assert MinimumWork(DYNAMICS, 1.1).evaluate(start, end) == pytest.approx(expected, rel=2e-3, abs=1e-3)


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_work_is_at_least_the_energy_gained(seed):
    """Signed work is the gain of potential energy, as the person rests at both ends; positive work is never less."""
    start, end = postures(seed), postures(seed + 1)
    gain = DYNAMICS.potential_energy(end) - DYNAMICS.potential_energy(start)
    assert MinimumWork(DYNAMICS).evaluate(start, end) >= gain - 1e-3


def test_a_pendulum_lifted_slowly_costs_its_potential_energy():
    dynamics = BodyDynamics(pendulum(), 80.0)
    cost = MinimumWork(dynamics, 30.0)
    end = np.array([1.2, 0.0])
    gain = dynamics.potential_energy(end) - dynamics.potential_energy(np.zeros(2))
    assert cost.evaluate(np.zeros(2), end) == pytest.approx(float(gain), rel=1e-3)
    assert cost.evaluate(end, np.zeros(2)) == pytest.approx(0.0, abs=1e-2)


@settings(max_examples=8, deadline=None)
@given(seeds)
def test_torque_change_equals_a_plain_loop(seed):
    start, end = postures(seed), postures(seed + 1)
    time, path = plain_reach(start, end, 1.1)
    rates = rate(path, time)
    torques = DYNAMICS.inverse_dynamics(path, rates, rate(rates, time))
    expected = np.trapezoid(np.square(rate(torques, time)).sum(axis=1), time)
    assert MinimumTorqueChange(DYNAMICS, 1.1).evaluate(start, end) == pytest.approx(expected, rel=1e-2)


@settings(max_examples=8, deadline=None)
@given(seeds)
def test_jerk_equals_a_plain_loop(seed):
    start, end = postures(seed), postures(seed + 1)
    time, path = plain_reach(start, end, 0.8)
    expected = 0.0
    for hand in hand_frames(SKELETON).values():
        way = relative_pose(SKELETON, path, WORLD_FRAME, hand.frame)[:, :3, 3]
        expected += np.trapezoid(np.square(rate(rate(rate(way, time), time), time)).sum(axis=1), time)
    assert MinimumJerk(SKELETON, duration=0.8).evaluate(start, end) == pytest.approx(expected, rel=2e-2)


@given(st.floats(0.01, 1.0), st.floats(0.3, 3.0))
def test_jerk_of_a_straight_line(distance, duration):
    """The least of all jerks from rest to rest along a line: 720 d2 / T5 (Flash and Hogan 1985)."""
    slide = Joint("slide", JointKind.PRISMATIC, WORLD, "drawer", ("open",), np.array([[0.6, 0.8, 0.0]]), np.zeros(3))
    skeleton = Skeleton("drawer", (slide,), (), (), np.zeros((0, 3)), np.zeros(1), np.ones(1))
    cost = MinimumJerk(skeleton, (Frame("drawer", np.eye(4)),), duration)
    expected = 720.0 * distance**2 / duration**5
    assert cost.evaluate(np.zeros(1), np.array([distance])) == pytest.approx(expected, rel=1e-5)


@settings(max_examples=6, deadline=None)
@given(st.sampled_from(sorted(COSTS)), seeds)
def test_gradient_predicts_a_small_change(name, seed):
    cost = load_cost(name, SKELETON, PERSON.mass)
    start, end = postures(seed), postures(seed + 1)
    step = 1e-4 * np.random.default_rng(seed).normal(size=14)
    change = cost.evaluate(start, end + step) - cost.evaluate(start, end - step)
    slope = cost_gradient(cost, start, end)
    assert change == pytest.approx(2.0 * slope @ step, rel=5e-2, abs=1e-4 * np.linalg.norm(slope) * 0.1)


def test_unknown_names_and_unfit_skeletons_are_refused():
    with pytest.raises(UnknownNameError, match=r"least_effort.*minimum_jerk, minimum_torque_change, minimum_work"):
        load_cost("least_effort", SKELETON, PERSON.mass)
    with pytest.raises(BadModelError, match="no hands"):
        load_cost("minimum_jerk", pendulum(), 75.0)
    with pytest.raises(BadModelError, match="world"):
        MinimumJerk(SKELETON, (WORLD_FRAME,))
