"""Costs of arm postures: squared distance, effort against gravity, RULA."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.arm.model import JOINT_NAMES, arm_of, arm_posture, load_arm
from handover_ros.ergonomics import arm_costs
from handover_ros.ergonomics.anthropometry import FOREARM, HAND, HAND_OVER_FOREARM, UPPER_ARM
from handover_ros.ergonomics.arm_costs import (
    ARM_COSTS,
    ELBOW_STRENGTH,
    GRAVITY,
    SHOULDER_STRENGTH,
    GravityTorque,
    Preference,
    RapidUpperLimbAssessment,
    SquaredDistance,
    load_arm_cost,
)
from handover_ros.ergonomics.dynamics import BodyDynamics
from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.jacobian import WORLD_FRAME, Frame, manipulator_jacobian

PERSON = load_person("adult")
SKELETON = skeleton_of(PERSON)
RIGHT, LEFT = load_arm(side="right"), load_arm(side="left")
MASS = 75.0
# [N m]: the arm's hand lies along wrist and grip, the skeleton's along the forearm, so that its 0.45 kg act up to 2 cm
# beside each other; the light links between the axes of one joint are less.
TORQUE = 0.1
seeds = st.integers(0, 10**6)
names = st.sampled_from(sorted(ARM_COSTS))


def postures(seed, arm, *shape):
    return np.random.default_rng(seed).uniform(*arm.limits, (*shape, 7))


def posture(**degrees):
    """Return a posture (7,) from joint angles [deg]; the others are zero, the forearm in the middle of its range."""
    given = {"forearm_pronation": float(np.rad2deg(RIGHT.limits[:, 4].mean())), **degrees}
    return np.deg2rad([given.get(name, 0.0) for name in JOINT_NAMES])


def moments(arm, q, body_mass, held):
    """Return the moments (3,) of the weights about shoulder and elbow, one part of the arm after the other."""
    shoulder, elbow, wrist, grip = arm.limbs(q)
    along = (grip - wrist) / np.linalg.norm(grip - wrist)
    about_shoulder, about_elbow = np.zeros(3), np.zeros(3)
    for mass, place, is_upper in (
        (UPPER_ARM.mass * body_mass, shoulder + UPPER_ARM.centre * (elbow - shoulder), True),
        (FOREARM.mass * body_mass, elbow + FOREARM.centre * (wrist - elbow), False),
        (HAND.mass * body_mass, wrist + HAND.centre * HAND_OVER_FOREARM * arm.forearm * along, False),
        (held, grip, False),
    ):
        weight = np.array([0.0, 0.0, -GRAVITY * mass])
        about_shoulder += np.cross(place - shoulder, weight)
        if not is_upper:
            about_elbow += np.cross(place - elbow, weight)
    return about_shoulder, about_elbow


@given(names, seeds)
@settings(max_examples=60, deadline=None)
def test_costs_are_finite_not_negative_and_each_posture_is_alone(name, seed):
    """Any posture within the limits has a cost of its own, whatever the shape of the array it comes in."""
    for arm in (RIGHT, LEFT):
        cost = load_arm_cost(name, arm, Preference(), MASS, 0.5)
        assert cost.name == name
        q = postures(seed, arm, 3, 4)
        many = cost.evaluate(q)
        assert many.shape == (3, 4)
        assert np.isfinite(many).all()
        assert (many >= 0.0).all()
        for index in np.ndindex(3, 4):
            assert float(cost.evaluate(q[index])) == pytest.approx(many[index], rel=1e-12)
        assert cost.evaluate(np.empty((0, 7))).shape == (0,)


@given(names, seeds)
@settings(max_examples=60, deadline=None)
def test_a_left_arm_costs_what_its_mirror_image_costs(name, seed):
    """The same displacements cost the same on both sides."""
    q = postures(seed, RIGHT, 20)
    costs = [load_arm_cost(name, arm, Preference(), MASS, 0.5).evaluate(q) for arm in (RIGHT, LEFT)]
    np.testing.assert_allclose(*costs, rtol=1e-12, atol=1e-12)


@given(seeds)
@settings(max_examples=50, deadline=None)
def test_squared_distance_is_equation_3_2(seed):
    """(q - q*)^T W (q - q*): zero at the neutral posture, four times as much twice as far away."""
    rng = np.random.default_rng(seed)
    preference = Preference(rng.normal(size=7), rng.uniform(0.0, 2.0, 7))
    cost = SquaredDistance(preference)
    assert cost.evaluate(preference.neutral) == 0.0
    offset = rng.normal(size=7)
    expected = offset @ np.diag(preference.weights) @ offset
    assert cost.evaluate(preference.neutral + offset) == pytest.approx(expected)
    assert cost.evaluate(preference.neutral - 2.0 * offset) == pytest.approx(4.0 * expected)


@given(seeds, st.floats(0.0, 3.0), st.floats(40.0, 120.0))
@settings(max_examples=60, deadline=None)
def test_gravity_torque_is_the_sum_of_the_weights_moments(seed, held, mass):
    """Squared shares of strength of the moments of upper arm, forearm, hand and object."""
    for arm in (RIGHT, LEFT):
        q = postures(seed, arm)
        shoulder, elbow = (np.linalg.norm(m) for m in moments(arm, q, mass, held))
        expected = (shoulder / SHOULDER_STRENGTH) ** 2 + (elbow / ELBOW_STRENGTH) ** 2
        assert GravityTorque(arm, mass, held).evaluate(q) == pytest.approx(expected, rel=1e-9, abs=1e-15)


def solved(axes, torques):
    """Return the vector (3,) with these components along three axes (rows), or None where they nearly are in a plane"""
    return np.linalg.solve(axes, torques) if abs(np.linalg.det(axes)) > 0.2 else None


@pytest.mark.parametrize("side", ["right", "left"])
def test_gravity_torque_is_that_of_the_bodys_dynamics(side, monkeypatch):
    """The norms about shoulder and elbow are those that the torques of the skeleton's joints add up to, to 0.1 N m.

    The moment about the shoulder follows from its three joints; that about the elbow from flexion, pronation and the
    fact that weights have no moment about the vertical.
    """
    arm, dynamics = arm_of(SKELETON, side), BodyDynamics(SKELETON, PERSON.mass)
    columns = [SKELETON.displacement_names.index(f"{side}_{name}") for name in JOINT_NAMES]
    rng = np.random.default_rng(0)
    checked = {"shoulder": 0, "elbow": 0}
    for _ in range(60):
        displacements = rng.uniform(SKELETON.lower, SKELETON.upper)
        torques = dynamics.gravity_torque(displacements)[columns]
        hand = Frame(f"{side}_hand", np.eye(4))
        axes = manipulator_jacobian(SKELETON, displacements, WORLD_FRAME, hand)[3:, columns].T
        cost = GravityTorque(arm, PERSON.mass)
        q = arm_posture(arm, SKELETON, displacements)
        about = {
            "shoulder": solved(axes[:3], torques[:3]),
            "elbow": solved(np.vstack([axes[3:5], [0.0, 0.0, 1.0]]), np.append(torques[3:5], 0.0)),
        }
        for joint, moment in about.items():
            if moment is None:
                continue
            other = "ELBOW_STRENGTH" if joint == "shoulder" else "SHOULDER_STRENGTH"
            strength = SHOULDER_STRENGTH if joint == "shoulder" else ELBOW_STRENGTH
            with monkeypatch.context() as patch:
                patch.setattr(arm_costs, other, np.inf)
                found = strength * np.sqrt(cost.evaluate(q))
            assert found == pytest.approx(np.linalg.norm(moment), abs=TORQUE)
            checked[joint] += 1
    assert min(checked.values()) > 15


def test_a_hanging_arm_needs_next_to_no_effort_and_a_stretched_one_the_most():
    """Gravity acts by horizontal levers: least hanging, most with the arm straight out to the front or side."""
    cost = GravityTorque(RIGHT, MASS, 1.0)
    hanging, front, side = (
        float(cost.evaluate(posture(**given)))
        for given in ({}, {"shoulder_flexion": 90.0}, {"shoulder_abduction": 90.0})
    )
    assert hanging < 0.01 * front
    assert front == pytest.approx(side, rel=0.05)
    assert (cost.evaluate(postures(1, RIGHT, 2000)) <= 1.05 * max(front, side)).all()
    assert GravityTorque(RIGHT, MASS, 2.0).evaluate(posture(shoulder_flexion=90.0)) > front
    assert GravityTorque(RIGHT, 2 * MASS, 2.0).evaluate(posture(shoulder_flexion=90.0)) == pytest.approx(4.0 * front)


# What the worksheet of McAtamney and Corlett gives by hand: upper arm, lower arm, wrist and twist read in table A.
RULA_EXAMPLES = [
    ({"shoulder_flexion": 10.0, "elbow_flexion": 80.0}, 1),  # 1, 1, 1, 1: the best there is
    ({"shoulder_flexion": 10.0, "elbow_flexion": 30.0}, 2),  # lower arm below 60 deg: 2
    ({"shoulder_flexion": 10.0, "elbow_flexion": 120.0}, 2),  # beyond 100 deg: 2
    ({"shoulder_flexion": 30.0, "elbow_flexion": 80.0}, 2),  # upper arm 20 to 45 deg: 2
    ({"shoulder_flexion": 60.0, "elbow_flexion": 80.0}, 3),  # 45 to 90 deg: 3
    ({"shoulder_flexion": -30.0, "elbow_flexion": 80.0}, 2),  # extension beyond 20 deg: 2
    ({"shoulder_flexion": -49.0, "elbow_flexion": 80.0}, 2),  # as far as it goes: still 2
    ({"shoulder_flexion": -10.0, "elbow_flexion": 80.0}, 1),  # extension up to 20 deg: 1
    ({"shoulder_flexion": 10.0, "elbow_flexion": 80.0, "wrist_flexion": 10.0}, 2),  # wrist 2
    ({"shoulder_flexion": 10.0, "elbow_flexion": 80.0, "wrist_flexion": -30.0}, 2),  # wrist 3
    ({"shoulder_flexion": 10.0, "elbow_flexion": 80.0, "wrist_flexion": 30.0, "wrist_deviation": 15.0}, 3),  # wrist 4
    ({"shoulder_flexion": 10.0, "elbow_flexion": 80.0, "forearm_pronation": 78.0}, 2),  # twist at its end: 2
    ({"shoulder_flexion": 10.0, "elbow_flexion": 80.0, "wrist_flexion": 10.0, "forearm_pronation": -80.0}, 2),
    ({"shoulder_flexion": 60.0, "elbow_flexion": 80.0, "wrist_flexion": 10.0}, 4),  # 3, 1, 2, 1
    ({"shoulder_flexion": 10.0, "shoulder_rotation": 60.0, "elbow_flexion": 80.0}, 2),  # across the midline: lower 2
    ({"shoulder_flexion": 120.0, "elbow_flexion": 80.0}, 5),  # above 90 deg: 4, and raised: 5; 5, 1, 1, 1
]


@pytest.mark.parametrize(("degrees", "score"), RULA_EXAMPLES)
@pytest.mark.parametrize("arm", [RIGHT, LEFT], ids=["right", "left"])
def test_rula_gives_the_worksheets_scores(arm, degrees, score):
    """The paper's categories, read by hand."""
    assert RapidUpperLimbAssessment(arm).evaluate(posture(**degrees)) == score


def test_rula_abduction_and_outward_hands_are_worse():
    """A raised, abducted upper arm and a hand far out score more than the arm in front."""
    rula = RapidUpperLimbAssessment(RIGHT)
    near = rula.evaluate(posture(shoulder_flexion=10.0, elbow_flexion=80.0))
    abducted = rula.evaluate(posture(shoulder_abduction=40.0, elbow_flexion=80.0))
    far_out = rula.evaluate(posture(shoulder_flexion=15.0, shoulder_rotation=-60.0, elbow_flexion=80.0))
    assert near == 1.0
    assert abducted == 3.0  # 2 for 20 to 45 deg and 1 for abduction; 3, 1, 1, 1
    assert far_out == 2.0


@given(seeds)
@settings(max_examples=50, deadline=None)
def test_rula_scores_are_those_of_table_a(seed):
    """Whole numbers from 1 to 9."""
    scores = RapidUpperLimbAssessment(RIGHT).evaluate(postures(seed, RIGHT, 50))
    assert set(scores.tolist()) <= set(map(float, range(1, 10)))


def test_rula_table_never_falls_with_a_worse_part():
    """A worse upper arm, lower arm, wrist or twist never lowers the score: a slip in the table would."""
    for axis in range(4):
        assert (np.diff(arm_costs.RULA_TABLE, axis=axis) >= 0).all()
    assert arm_costs.RULA_TABLE.shape == (6, 3, 4, 2)


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"neutral": np.zeros(6)}, "neutral needs 7"),
        ({"neutral": np.full(7, np.nan)}, "neutral"),
        ({"weights": np.full(7, np.inf)}, "weights"),
        ({"weights": np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -0.1])}, "negative"),
    ],
)
def test_impossible_preferences_are_refused(fields, word):
    """The message names the field."""
    with pytest.raises(BadRequestError, match=word):
        Preference(**fields)


def test_preferences_do_not_change():
    """Their arrays are read-only copies."""
    neutral = np.zeros(7)
    preference = Preference(neutral)
    neutral[0] = 1.0
    assert preference.neutral[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        preference.weights[0] = 2.0
    assert replace(preference, weights=np.zeros(7)).weights.sum() == 0.0


@pytest.mark.parametrize("body", [5.0, 500.0, np.nan])
def test_impossible_body_masses_are_refused(body):
    """A person's mass has a range, and the message tells it."""
    with pytest.raises(BadRequestError, match="between 10 and 400"):
        load_arm_cost("gravity_torque", RIGHT, Preference(), body)


@pytest.mark.parametrize("held", [-0.1, 80.0, np.nan])
def test_impossible_held_masses_are_refused(held):
    """What a hand holds weighs something between nothing and the person."""
    with pytest.raises(BadRequestError, match="held mass"):
        load_arm_cost("gravity_torque", RIGHT, Preference(), MASS, held)


@pytest.mark.parametrize("name", sorted(ARM_COSTS))
def test_postures_of_another_shape_are_refused(name):
    """Six displacements, or one, are not an arm's."""
    cost = load_arm_cost(name, RIGHT, Preference())
    for wrong in (np.zeros(6), np.zeros((3, 1)), 0.0):
        with pytest.raises(BadRequestError, match="7 displacements"):
            cost.evaluate(wrong)


def test_unknown_costs_list_the_known():
    """The message names all costs, and every cost has a line for people."""
    with pytest.raises(UnknownNameError, match="gravity_torque, rula, squared_distance"):
        load_arm_cost("beauty", RIGHT, Preference())
    assert all(maker.summary for maker in ARM_COSTS.values())
