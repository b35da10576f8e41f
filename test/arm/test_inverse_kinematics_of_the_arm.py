"""The inverse kinematics of the arm: complete, within the limits, and the same as its plain twin's."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros import threads
from handover_ros.arm import inverse_kinematics, reference
from handover_ros.arm.inverse_kinematics import (
    best_postures,
    feasible_arcs,
    feasible_sets,
    posture_at,
    weigh,
    weigh_quadratic,
    weigh_quadratic_segments,
)
from handover_ros.arm.model import AXES, Arm, load_arm
from handover_ros.errors import BadRequestError

FULL_TURN = 2.0 * math.pi
ADULTS = {side: load_arm("adult", side) for side in ("right", "left")}
WEIGHTS = np.array([1.0, 1.2, 0.7, 0.6, 0.35, 0.6, 1.0])
NEUTRAL = np.array([0.45, 0.2, 0.25, 1.35, 0.3, 0.0, 0.0])
GRID = np.linspace(0.0, FULL_TURN, 720, endpoint=False) + 0.0012345
KINDS = ("adult", "narrow", "wide", "full", "folding")
SEEDS = st.integers(0, 10**9)


def random_arm(rng, kind):
    """Return an adult's arm, or one of random lengths and limits; full: half a turn either way."""
    side = ("right", "left")[rng.integers(2)]
    if kind == "adult":
        return ADULTS[side]
    upper, fore = rng.uniform(0.2, 0.4, 2)
    lower = rng.uniform(-math.pi, math.pi - 0.3, 7)
    limits = np.array([lower, np.minimum(lower + rng.uniform(0.3, 2.0 if kind == "narrow" else 5.0, 7), math.pi)])
    if kind in ("full", "folding"):
        limits = np.array([[-math.pi] * 7, [math.pi] * 7])
    if kind == "folding":
        fore = upper
        limits[:, [0, 1, 2, 4, 5, 6]] *= rng.uniform(0.5, 1.0, (2, 6))
    return Arm(side, upper, fore, 0.2 * rng.normal(size=3), 0.09, 0.04, limits)


def with_limits(arm, joint, low, high):
    limits = np.array(arm.limits)
    limits[:, joint] = low, high
    return replace(arm, limits=limits)


def on_arc(arcs, branch, swivel, ignore=0, tolerance=1e-7):
    """Return whether an arc of the branch has a swivel angle; branches that differ in bits of ``ignore`` are one."""
    return any(
        (arc.branch | ignore) == (branch | ignore)
        and (swivel - arc.start + tolerance) % FULL_TURN <= arc.end - arc.start + 2.0 * tolerance
        for arc in arcs
    )


def turned_to(arm, displacements, direction):
    """Return displacements whose wrist lies in a direction from the shoulder, elbow and wrist bent as before."""
    shoulder, _, wrist, _ = arm.limbs(displacements)
    mirror = [1.0, 1.0 if arm.side == "right" else -1.0, 1.0]
    line = (wrist - shoulder) * mirror
    turn = Rotation.align_vectors([direction], [line / np.linalg.norm(line)])[0]
    turns = [Rotation.from_rotvec(angle * axis) for angle, axis in zip(displacements[:3], AXES)]
    angles = (turn * turns[0] * turns[1] * turns[2]).as_euler("YXZ") * [-1.0, -1.0, 1.0]
    return np.concatenate([angles - FULL_TURN * np.round(angles / FULL_TURN), displacements[3:]])


def assert_answers(arm, pose, displacements, ignore=0):
    """Assert that the posture's place is on an arc, and that the best posture next to it is the posture itself."""
    arcs = feasible_arcs(arm, pose)
    branch, swivel = reference.place_of(arm, displacements)
    assert on_arc(arcs, branch, swivel, ignore), (branch, swivel, arcs)
    postures, costs = best_postures(arm, pose, displacements, np.ones(7))
    assert costs[0] < (math.inf if ignore else 1e-9)
    assert_reaches(arm, pose, postures)


def assert_reaches(arm, pose, postures):
    assert arm.within_limits(postures, 2e-9).all()
    np.testing.assert_allclose(arm.hand_pose(postures), np.broadcast_to(pose, (len(postures), 4, 4)), atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_finds_every_posture_within_the_limits(kind, seed):
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, kind)
    q = rng.uniform(*arm.limits)
    assert_answers(arm, arm.hand_pose(q), q)


@pytest.mark.parametrize("kind", ["adult", "narrow", "wide"])
@settings(max_examples=100, deadline=None)
@given(seed=SEEDS)
def test_finds_postures_at_limits(kind, seed):
    """Of one joint up to all of them; where two or more meet, the feasible set may be this one posture.

    But not an elbow folded up: a distance of two lengths says where it is to 1e-8 rad only.
    """
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, kind)
    at_limit = rng.random(7) < rng.uniform(0.1, 1.0)
    at_limit[3] &= np.abs(arm.limits[:, 3]).max() < 3.0
    q = np.where(at_limit, arm.limits[rng.integers(2, size=7), np.arange(7)], rng.uniform(*arm.limits))
    assert_answers(arm, arm.hand_pose(q), q)


@pytest.mark.parametrize(("joint", "bit"), [(1, 2), (5, 4)])
@pytest.mark.parametrize("kind", ["adult", "narrow", "wide", "full"])
@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_finds_postures_whose_outer_angles_are_not_determined(kind, joint, bit, seed):
    """Shoulder or wrist at a right angle: only the sum or difference of the outer two counts, one choice is found."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, kind)
    sign = rng.choice([-1.0, 1.0])
    ends = sorted([sign * rng.uniform(0.0, 1.5), sign * rng.uniform(1.6, math.pi)])
    arm = with_limits(arm, joint, *ends)
    q = rng.uniform(*arm.limits)
    q[joint] = sign * math.pi / 2.0
    assert_answers(arm, arm.hand_pose(q), q, ignore=bit)


@pytest.mark.parametrize("limits", [(0.0, 2.5), (-2.5, 0.0), (-1.0, 1.0), (0.0, 0.0)])
@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_finds_straight_arms(limits, seed):
    """Then four angles do not change along the circle, and may all be at limits."""
    rng = np.random.default_rng(seed)
    arm = with_limits(random_arm(rng, KINDS[rng.integers(3)]), 3, *limits)
    at_limit = rng.random(7) < rng.choice([0.0, 0.5])
    q = np.where(at_limit, arm.limits[rng.integers(2, size=7), np.arange(7)], rng.uniform(*arm.limits))
    q[3] = 0.0
    assert_answers(arm, arm.hand_pose(q), q)


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_finds_elbows_bent_backwards(seed):
    rng = np.random.default_rng(seed)
    arm = with_limits(random_arm(rng, KINDS[rng.integers(4)]), 3, -2.6, rng.choice([-0.1, 2.0]))
    q = rng.uniform(*arm.limits)
    q[3] = -rng.uniform(0.1, 2.6)
    assert_answers(arm, arm.hand_pose(q), q)
    assert all(arc.branch & 1 for arc in feasible_arcs(with_limits(arm, 3, -2.6, -0.1), arm.hand_pose(q)))


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_a_wrist_at_the_shoulder_is_found(seed):
    """Such an arm may turn about the shoulder freely; what is found turns about the vertical."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, "folding")
    q = rng.uniform(*arm.limits)
    q[:3], q[3] = [0.0, rng.uniform(*np.clip(arm.limits[:, 1], -1.5, 1.5)), 0.0], math.pi
    pose = arm.hand_pose(q)
    postures, costs = best_postures(arm, pose, q, np.ones(7))
    if np.isfinite(costs[0]):
        assert_reaches(arm, pose, postures)
        assert abs(postures[0, 3]) == pytest.approx(math.pi, abs=1e-6)
    else:
        assert not reference.feasible_swivels(arm, pose, GRID, -1e-7).any()


@pytest.mark.parametrize("direction", [(0.0, 0.0, -1.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)])
@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_finds_wrists_straight_above_below_and_beside_the_shoulder(direction, seed):
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, KINDS[1:4][rng.integers(3)])
    q = turned_to(arm, rng.uniform(*arm.limits), direction)
    limits = np.array(arm.limits)
    limits[:, :3] = np.stack([np.maximum(q[:3] - 0.4, -math.pi), np.minimum(q[:3] + 0.2, math.pi)])
    arm = replace(arm, limits=limits)
    assert_answers(arm, arm.hand_pose(q), q)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_arcs_are_those_of_the_plain_twin(kind, seed):
    """Feasible angles of a grid lie in arcs; the twin agrees with the inside of arcs; at their ends is a limit."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, kind)
    pose = arm.hand_pose(rng.uniform(*arm.limits))
    if rng.random() < 0.3:
        pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    arcs = feasible_arcs(arm, pose)
    for branch, row in enumerate(reference.feasible_swivels(arm, pose, GRID, -1e-9)):
        assert all(on_arc(arcs, branch, swivel) for swivel in GRID[row])
    for arc in arcs:
        inside = np.linspace(arc.start, arc.end, 9)[1:-1]
        assert reference.feasible_swivels(arm, pose, inside, 1e-8)[arc.branch].all()
        if kind != "full" and arc.end - arc.start < FULL_TURN - 1e-9:  # there they also end where a joint jumps
            for end, step in ((arc.start, -1e-5), (arc.end, 1e-5)):
                q = posture_at(arm, pose, arc.branch, end)
                if q is not None:  # not where rounding takes it out
                    assert np.abs(q - arm.limits).min() < 1e-6 or near_pole(q)
                    beyond = np.array([end + step])
                    assert not reference.feasible_swivels(arm, pose, beyond, -1e-7)[arc.branch, 0]
    total = sum(arc.end - arc.start for arc in arcs)
    assert total <= 8.0 * FULL_TURN + 1e-9


def near_pole(q):
    return min(abs(math.cos(q[1])), abs(math.cos(q[5]))) < 1e-6


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, width=st.floats(1e-6, 1e-4))
def test_finds_narrow_arcs(seed, width):
    """A limit set so that this much of an arc is left: its start is where the arc's was, its end there."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, KINDS[rng.integers(3)])
    pose = arm.hand_pose(rng.uniform(*arm.limits))
    arc = max(feasible_arcs(arm, pose), key=lambda arc: arc.end - arc.start)
    start, end = (reference.postures(arm, pose, np.array([arc.start + at]))[arc.branch, 0] for at in (0.0, width))
    joint = max((0, 1, 2, 4, 5, 6), key=lambda joint: abs(end[joint] - start[joint]))
    rises = end[joint] > start[joint]
    if arc.end - arc.start < 2.0 * width or abs(end - start)[joint] > 1.0:
        return
    ends = (arm.limits[0, joint], end[joint]) if rises else (end[joint], arm.limits[1, joint])
    narrow = [each for each in feasible_arcs(with_limits(arm, joint, *ends), pose) if each.branch == arc.branch]
    found = [each for each in narrow if on_arc([each], arc.branch, arc.start + 0.5 * width, tolerance=0.0)]
    assert len(found) == 1
    assert found[0].end - found[0].start == pytest.approx(width, rel=1e-3)
    postures, costs = best_postures(with_limits(arm, joint, *ends), pose, 0.5 * (start + end), WEIGHTS)
    assert np.isfinite(costs[0])
    assert_reaches(arm, pose, postures)


@pytest.mark.parametrize("kind", KINDS[:3])
@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_the_best_posture_is_better_than_any_sample(kind, seed):
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, kind)
    pose = arm.hand_pose(rng.uniform(*arm.limits))
    neutral, weights = rng.uniform(*arm.limits), rng.uniform(0.0, 2.0, 7)
    _, costs = best_postures(arm, pose, neutral, weights)
    _, least = reference.best_posture(arm, pose, neutral, weights, GRID)
    assert costs[0] <= least + 1e-9
    samples = feasible_sets(arm, pose, 0.01).of(0)
    assert costs[0] <= (((samples - neutral) ** 2) @ weights).min(initial=np.inf) + 1e-9
    for arc in feasible_arcs(arm, pose):  # nor is it a stretch's end that is not feasible
        ends = reference.postures(arm, pose, np.linspace(arc.start, arc.end, 50))[arc.branch]
        ends = ends[arm.within_limits(ends)]
        assert costs[0] <= (((ends - neutral) ** 2) @ weights).min(initial=np.inf) + 1e-9


@pytest.mark.parametrize("side", ADULTS)
def test_samples_reach_the_hand_within_the_limits(side):
    arm = ADULTS[side]
    rng = np.random.default_rng(3)
    poses = arm.hand_pose(rng.uniform(*arm.limits, size=(300, 7)))
    sets = feasible_sets(arm, poses, 0.2)
    assert sets.first[-1] == len(sets.postures) == len(sets.measures)
    assert (np.diff(sets.first) > 0).all()
    assert (sets.measures <= 0.2 + 1e-12).all()
    assert arm.within_limits(sets.postures, 2e-9).all()
    expected = np.repeat(poses, np.diff(sets.first), axis=0)
    np.testing.assert_allclose(arm.hand_pose(sets.postures), expected, atol=1e-9)
    for index in (0, 17, 299):
        np.testing.assert_array_equal(sets.of(index), sets.postures[sets.first[index] : sets.first[index + 1]])


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_measures_are_lengths_in_configuration_space(seed):
    """Measured along chords of up to 0.4 rad: a few percent short where an arc passes close by a pole."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, KINDS[rng.integers(4)])
    pose = arm.hand_pose(rng.uniform(*arm.limits))
    total = 0.0
    for arc in feasible_arcs(arm, pose):
        q = reference.postures(arm, pose, np.linspace(arc.start, arc.end, 2001))[arc.branch]
        moved = np.diff(q, axis=0)
        total += np.linalg.norm(moved - FULL_TURN * np.round(moved / FULL_TURN), axis=1).sum()
    assert feasible_sets(arm, pose, 0.1).measures.sum() == pytest.approx(total, rel=0.05, abs=1e-4)


def test_halving_the_step_changes_integrals_little():
    arm = ADULTS["right"]
    poses = arm.hand_pose(np.random.default_rng(5).uniform(*arm.limits, size=(200, 7)))
    coarse, fine, finest = (weigh_quadratic(arm, poses, step, NEUTRAL, WEIGHTS, 2.0) for step in (0.1, 0.05, 0.0125))
    np.testing.assert_allclose(coarse[:, 0], finest[:, 0], rtol=1e-9, atol=1e-5)
    np.testing.assert_allclose(coarse[:, 1:4], finest[:, 1:4], atol=0.01)
    changes = [np.abs(each[:, 1:4] - finest[:, 1:4]).max() for each in (coarse, fine)]
    assert changes[1] < 0.4 * changes[0]  # second order: a quarter
    _, least = best_postures(arm, poses, NEUTRAL, WEIGHTS)
    assert (least <= finest[:, 4] + 1e-12).all()
    np.testing.assert_allclose(finest[:, 4], least, atol=0.05)


@pytest.mark.parametrize("rationality", [0.0, 1.0, 10.0, math.inf])
@pytest.mark.parametrize("side", ADULTS)
def test_weighing_at_once_is_sampling_and_weighing(side, rationality):
    arm = ADULTS[side]
    rng = np.random.default_rng(7)
    poses = arm.hand_pose(rng.uniform(*arm.limits, size=(150, 7)))
    poses[::9, :3, 3] += 2.0  # out of reach
    sets = feasible_sets(arm, poses, 0.1)
    costs = ((sets.postures - NEUTRAL) ** 2) @ WEIGHTS
    table = weigh(sets, costs, rationality)
    at_once = weigh_quadratic(arm, poses, 0.1, NEUTRAL, WEIGHTS, rationality)
    np.testing.assert_allclose(at_once, table, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(
        at_once, weigh_quadratic_segments(arm, arm.segment_poses(poses), 0.1, NEUTRAL, WEIGHTS, rationality)
    )
    assert (table[::9, 0] == 0.0).all()
    assert (table[::9, 1] == -np.inf).all()
    assert np.isposinf(table[::9, 2:]).all()
    for index in (1, 50, 149):  # what the columns say
        part = slice(sets.first[index], sets.first[index + 1])
        cost, measure = costs[part], sets.measures[part]
        shares = measure * (cost == cost.min() if math.isinf(rationality) else np.exp(-rationality * cost))
        expected = [measure.sum(), np.log(shares.sum()), shares @ cost / shares.sum(), measure @ cost / measure.sum()]
        known = [0, 2, 3] if math.isinf(rationality) else [0, 1, 2, 3]
        np.testing.assert_allclose(table[index, known], np.array(expected)[known], rtol=1e-9)
        assert table[index, 4] == cost.min()


def test_a_great_rationality_does_not_underflow():
    arm = ADULTS["right"]
    poses = arm.hand_pose(np.random.default_rng(8).uniform(*arm.limits, size=(40, 7)))
    table = weigh_quadratic(arm, poses, 0.1, NEUTRAL, WEIGHTS, 1e6)
    assert np.isfinite(table).all()
    np.testing.assert_allclose(table[:, 2], table[:, 4], atol=1e-4)


def test_the_left_arm_is_the_mirror_image():
    right, left = ADULTS["right"], ADULTS["left"]
    q = np.random.default_rng(2).uniform(*right.limits, size=(50, 7))
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    poses = right.hand_pose(q)
    mirrored = mirror @ poses @ mirror
    np.testing.assert_allclose(left.hand_pose(q), mirrored, atol=1e-12)
    np.testing.assert_allclose(left.limbs(q), right.limbs(q) * [1.0, -1.0, 1.0], atol=1e-12)
    for one, other in zip(
        best_postures(right, poses, NEUTRAL, WEIGHTS), best_postures(left, mirrored, NEUTRAL, WEIGHTS)
    ):
        np.testing.assert_allclose(one, other, atol=1e-12)
    for one, other in zip(feasible_arcs(right, poses[0]), feasible_arcs(left, mirrored[0])):
        assert (other.branch, other.start, other.end) == (one.branch, pytest.approx(one.start), pytest.approx(one.end))


def test_many_poses_in_threads_are_as_one_by_one(monkeypatch):
    monkeypatch.setattr(inverse_kinematics, "LEAST_CHUNK", 7)
    monkeypatch.setattr(inverse_kinematics, "SAMPLES_PER_POSE", 1)  # so that more room is needed
    monkeypatch.setattr(threads.os, "sched_getaffinity", lambda _: {0, 1, 2})
    arm = ADULTS["right"]
    rng = np.random.default_rng(4)
    poses = arm.hand_pose(rng.uniform(*arm.limits, size=(50, 7)))
    poses[10:14, 2, 3] += 1.0
    sets = feasible_sets(arm, poses, 0.1)
    table = weigh_quadratic(arm, poses, 0.1, NEUTRAL, WEIGHTS, 3.0)
    postures, costs = best_postures(arm, poses, NEUTRAL, WEIGHTS)
    for index, pose in enumerate(poses):
        one = feasible_sets(arm, pose, 0.1)
        np.testing.assert_array_equal(sets.of(index), one.postures)
        np.testing.assert_array_equal(sets.measures[sets.first[index] : sets.first[index + 1]], one.measures)
        np.testing.assert_array_equal(table[index], weigh_quadratic(arm, pose, 0.1, NEUTRAL, WEIGHTS, 3.0)[0])
        posture, cost = best_postures(arm, pose, NEUTRAL, WEIGHTS)
        np.testing.assert_array_equal(postures[index], posture[0])
        assert costs[index] == cost[0]


def test_no_poses_give_nothing():
    arm, none = ADULTS["right"], np.zeros((0, 4, 4))
    assert feasible_sets(arm, none, 0.1).first.tolist() == [0]
    assert weigh_quadratic(arm, none, 0.1, NEUTRAL, WEIGHTS, 1.0).shape == (0, 5)
    assert best_postures(arm, none, NEUTRAL, WEIGHTS)[0].shape == (0, 7)


def test_out_of_reach_is_said_by_emptiness():
    arm = ADULTS["right"]
    pose = arm.hand_pose(np.zeros(7) + 0.1)
    pose[0, 3] += 2.0
    assert feasible_arcs(arm, pose) == ()
    assert posture_at(arm, pose, 0, 0.0) is None
    postures, costs = best_postures(arm, pose, NEUTRAL, WEIGHTS)
    assert np.isnan(postures).all()
    assert np.isposinf(costs).all()
    assert math.isinf(reference.best_posture(arm, pose, NEUTRAL, WEIGHTS, GRID)[1])


def test_posture_at_is_the_plain_twins():
    arm = ADULTS["left"]
    pose = arm.hand_pose(NEUTRAL)
    for arc in feasible_arcs(arm, pose):
        for swivel in np.linspace(arc.start, arc.end, 7)[1:-1]:
            q = posture_at(arm, pose, arc.branch, swivel)
            twin = reference.postures(arm, pose, np.array([swivel]))[arc.branch, 0]
            np.testing.assert_allclose(q, twin, atol=1e-9)
            assert_reaches(arm, pose, q[None])
    assert posture_at(arm, pose, 7, 0.0) is None


def pose_with(entry, value):
    pose = np.eye(4)
    pose[entry] = value
    return pose


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (pose_with((0, 3), np.nan), "finite"),
        (pose_with((1, 1), np.inf), "finite"),
        (np.eye(3), "shape"),
        (np.zeros(7), "shape"),
        (2.0 * np.eye(4), "orthonormal"),
        (pose_with((0, 1), 0.01), "orthonormal"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "right-handed"),
        (pose_with((3, 0), 0.1), "last row"),
    ],
)
def test_poses_that_are_none_are_refused(pose, message):
    arm = ADULTS["right"]
    for ask in (
        lambda: feasible_arcs(arm, pose),
        lambda: posture_at(arm, pose, 0, 0.0),
        lambda: feasible_sets(arm, pose, 0.1),
        lambda: weigh_quadratic(arm, pose, 0.1, NEUTRAL, WEIGHTS, 1.0),
        lambda: best_postures(arm, pose, NEUTRAL, WEIGHTS),
    ):
        with pytest.raises(BadRequestError, match=message):
            ask()


@pytest.mark.parametrize("step", [0.0, -0.1, math.nan])
def test_steps_must_be_positive(step):
    arm, pose = ADULTS["right"], np.eye(4)
    with pytest.raises(BadRequestError, match="step"):
        feasible_sets(arm, pose, step)
    with pytest.raises(BadRequestError, match="step"):
        weigh_quadratic(arm, pose, step, NEUTRAL, WEIGHTS, 1.0)


@pytest.mark.parametrize("row", [np.zeros(6), np.full(7, np.nan), np.zeros((7, 1)), [math.inf] * 7])
def test_costs_need_seven_finite_numbers(row):
    arm, pose = ADULTS["right"], np.eye(4)
    with pytest.raises(BadRequestError, match="neutral"):
        best_postures(arm, pose, row, WEIGHTS)
    with pytest.raises(BadRequestError, match="weights"):
        weigh_quadratic(arm, pose, 0.1, NEUTRAL, row, 1.0)
