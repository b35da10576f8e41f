"""Joint torques of a skeleton."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pendulum import pendulum

from handover_ros.ergonomics.anthropometry import segment_inertias
from handover_ros.ergonomics.dynamics import GRAVITY, BodyDynamics
from handover_ros.errors import BadModelError
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.jacobian import WORLD_FRAME, Frame, manipulator_jacobian

PERSON = load_person("adult")
SKELETON = skeleton_of(PERSON)
DYNAMICS = BodyDynamics(SKELETON, PERSON.mass)
INERTIAS = segment_inertias(SKELETON, PERSON.mass)
LIGHT = 2e-4  # [N m] the light links between the axes of one joint
seeds = st.integers(0, 10**6)


def postures(seed, *shape):
    return np.random.default_rng(seed).uniform(SKELETON.lower, SKELETON.upper, (*shape, len(SKELETON.lower)))


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_gravity_torque_is_the_weight_times_each_centres_jacobian(seed):
    theta = postures(seed)
    expected = np.zeros_like(theta)
    for segment, inertia in INERTIAS.items():
        pose = np.eye(4)
        pose[:3, 3] = inertia.centre
        jacobian = manipulator_jacobian(SKELETON, theta, WORLD_FRAME, Frame(segment, pose))
        expected -= jacobian[:3].T @ (inertia.mass * np.array(GRAVITY))
    np.testing.assert_allclose(DYNAMICS.gravity_torque(theta), expected, atol=LIGHT)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_gravity_torque_is_the_slope_of_the_potential_energy(seed):
    theta, step = postures(seed), 1e-5
    steps = step * np.eye(len(theta))
    slope = (DYNAMICS.potential_energy(theta + steps) - DYNAMICS.potential_energy(theta - steps)) / (2.0 * step)
    np.testing.assert_allclose(DYNAMICS.gravity_torque(theta), slope, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_torque_rate_is_the_torques_derivative(seed):
    rng = np.random.default_rng(seed)
    theta = postures(seed)
    v, a, jerk = rng.normal(size=(3, len(theta)))
    h = 1e-5

    def torque(t):
        return DYNAMICS.inverse_dynamics(
            theta + v * t + a * t**2 / 2 + jerk * t**3 / 6, v + a * t + jerk * t**2 / 2, a + jerk * t
        )

    expected = (torque(h) - torque(-h)) / (2.0 * h)
    np.testing.assert_allclose(DYNAMICS.torque_rate(theta, v, a, jerk), expected, rtol=1e-5, atol=1e-5)


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_many_samples_are_each_alone(seed):
    theta, rates, accelerations = postures(seed, 3, 4, 2)
    many = DYNAMICS.inverse_dynamics(theta, rates, accelerations)
    for index in np.ndindex(many.shape[:-1]):
        alone = DYNAMICS.inverse_dynamics(theta[index], rates[index], accelerations[index])
        np.testing.assert_array_equal(many[index], alone)


@given(st.floats(-2.5, 2.5), st.floats(-5.0, 5.0))
def test_a_pendulum(angle, acceleration):
    """Tau = I qdd + m g l sin(q), summed over the two rigidly joined parts."""
    skeleton = pendulum()
    dynamics = BodyDynamics(skeleton, 80.0)
    inertia = moment = 0.0
    for part in segment_inertias(skeleton, 80.0).values():
        distance = -part.centre[2]
        inertia += part.mass * distance**2 + part.tensor[1, 1]
        moment += part.mass * distance
    torque = dynamics.inverse_dynamics([angle, 0.0], [0.3, 0.0], [acceleration, 0.0])
    assert torque[0] == pytest.approx(inertia * acceleration + 9.80665 * moment * np.sin(angle), abs=1e-9)


def test_hanging_arms_cost_nothing_and_stretched_ones_most():
    hanging, stretched = np.zeros(14), np.zeros(14)
    stretched[0] = stretched[7] = np.pi / 2.0
    assert np.abs(DYNAMICS.gravity_torque(hanging)).max() < LIGHT
    torque = DYNAMICS.gravity_torque(stretched)
    assert 8.0 < torque[0] < 15.0  # an adult's arm held out: about 11 N m
    assert torque[7] == pytest.approx(torque[0], abs=LIGHT)


def test_without_gravity_holding_costs_nothing():
    dynamics = BodyDynamics(SKELETON, PERSON.mass, gravity=(0.0, 0.0, 0.0))
    assert np.abs(dynamics.gravity_torque(postures(1))).max() < 1e-12
    with pytest.raises(BadModelError, match="gravity"):
        BodyDynamics(SKELETON, PERSON.mass, gravity=(0.0, np.nan, 0.0))
