"""Statistics of feasible sets, end to end: inverse kinematics and loops give the same costs and choices."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handover_ros.arm.inverse_kinematics import feasible_sets
from handover_ros.arm.model import load_arm
from handover_ros.ergonomics.arm_costs import ARM_COSTS, Preference, load_arm_cost
from handover_ros.errors import BadRequestError
from handover_ros.geometry import invert_transform, make_transform, transform_from_xyz_rpy
from handover_ros.objects import load_object
from handover_ros.planning import choice_reference as plain
from handover_ros.planning.choice import (
    LEAST,
    LOG_WEIGHT,
    MEAN,
    MEASURE,
    PLAIN_MEAN,
    ChoiceModel,
    GoalCosts,
    grasp_probabilities,
    person_model,
)
from handover_ros.planning.feasible import Taker, posture_probabilities, statistics, statistics_each
from handover_ros.planning.grasp_set import grasp_set
from handover_ros.planning.objectives import OBJECTIVES, expected_cost
from handover_ros.planning.obstacles import obstacles_of

REGRASP = 2.0
ARMS = {side: load_arm(side=side) for side in ("right", "left")}
# Light, so that exp(-300 C) of the plain loops does not underflow.
PREFERENCE = Preference(weights=0.1 * Preference().weights)
TABLE = [(np.array([0.6, 1.2, 0.04]), make_transform(np.eye(3), [0.45, 0.0, -0.45]))]
GOALS = np.stack(
    [transform_from_xyz_rpy([0.42, -0.15, -0.40], [0.0, 0.0, 0.4]), transform_from_xyz_rpy([0.3, 0.3, -0.2], [0, 0, 3])]
)


def taker_of(sides, cost="squared_distance", step=0.4):
    arms = {side: ARMS[side] for side in sides}
    return Taker(arms, {side: load_arm_cost(cost, arm, PREFERENCE) for side, arm in arms.items()}, step)


def places(grasps, seed, count=3):
    """Return object poses (count, 4, 4) that put one grasp or another near a comfortable hand, turned at random."""
    rng = np.random.default_rng(seed)
    side = grasps.sides[0]
    hand = ARMS[side].hand_pose(PREFERENCE.neutral)
    found = []
    for _ in range(count):
        own = grasps.poses[0][rng.integers(len(grasps.poses[0]))]
        shake = make_transform(Rotation.from_rotvec(rng.normal(0.0, 0.25, 3)).as_matrix(), rng.normal(0.0, 0.05, 3))
        found.append(hand @ shake @ invert_transform(own))
    return np.stack(found)


def configurations(taker, side, torso_from_hand, obstacles=None):
    """Return (measure, cost) of the samples of one hand's feasible set, those that are free of obstacles."""
    arm = taker.arms[side]
    sets = feasible_sets(arm, torso_from_hand[None], taker.step)
    found = []
    for q, measure in zip(sets.postures, sets.measures, strict=True):
        if obstacles is None or obstacles.free(arm.limbs(q[None]))[0]:
            found.append((float(measure), float(taker.costs[side].evaluate(q))))
    return found


def ways(taker, grasps, torso_from_object, obstacles=None):
    """Return the configurations of every grasp: of two hands all pairs, measures multiplied and costs added."""
    found = []
    for index in range(len(grasps)):
        together = [(1.0, 0.0)]
        for side, pose in grasps.hand_poses(index).items():
            own = configurations(taker, side, torso_from_object @ pose, obstacles)
            together = [(m * n, c + d) for m, c in together for n, d in own]
        found.append(together)
    return found


def two_handed_places(count=3):
    """Return poses of the parcel in front of the chest, its long side across."""
    rng = np.random.default_rng(4)
    return np.stack(
        [
            transform_from_xyz_rpy([*rng.uniform([0.3, -0.05, -0.4], [0.42, 0.05, -0.3])], [0, 0, yaw])
            for yaw in (0, 0.2, 3.1)
        ]
    )[:count]


CASES = {
    "mug, right hand": ("mug", ("right",), 0.06, 1.0),
    "mug, either hand": ("mug", ("right", "left"), 0.06, 1.6),
    "handlebars, left hand": ("handlebars", ("left",), 0.06, 1.2),
    "box, both hands": ("box", ("right", "left"), 0.06, 1.0),
}


def case(name):
    """Return grasps, their object poses and those at the goal."""
    object_name, sides, length, angle = CASES[name]
    grasps = grasp_set(load_object(object_name), sides, length, angle)
    if object_name == "box":
        poses = two_handed_places()
        return grasps, poses, poses[1:] @ transform_from_xyz_rpy([0.02, 0.0, 0.05])
    if object_name == "handlebars":
        return grasps, places(grasps, 1), transform_from_xyz_rpy([0.05, 0.0, -0.1]) @ places(grasps, 2)
    return grasps, places(grasps, 1), GOALS


@pytest.mark.parametrize("cost", sorted(ARM_COSTS))
@pytest.mark.parametrize("name", CASES)
def test_statistics_are_those_of_the_sampled_sets(name, cost):
    """Measure, log weight, both means and the least cost of every grasp, at rationalities from 0 to infinity."""
    grasps, poses, _ = case(name)
    taker = taker_of(grasps.sides, cost, step=0.6)
    sampled = [ways(taker, grasps, pose) for pose in poses]
    assert any(entries for sets in sampled for entries in sets)
    for rationality in (0.0, 10.0, np.inf):
        table = statistics(taker, grasps, poses, rationality)
        assert table.shape == (len(poses), len(grasps), 5)
        for row, sets in zip(table, sampled, strict=True):
            for found, entries in zip(row, sets, strict=True):
                if not entries:
                    assert found[MEASURE] == 0.0
                    assert found[LOG_WEIGHT] == -np.inf
                    continue
                costs, measures = np.array([c for _, c in entries]), np.array([m for m, _ in entries])
                least = costs.min()
                assert found[MEASURE] == pytest.approx(measures.sum(), rel=1e-9)
                assert found[PLAIN_MEAN] == pytest.approx(plain.mean_cost(entries, 0.0), rel=1e-9)
                assert found[LEAST] == pytest.approx(least, abs=1e-9)
                if np.isinf(rationality):
                    assert found[MEAN] == pytest.approx(least, abs=1e-9)
                    continue
                assert found[MEAN] == pytest.approx(plain.mean_cost(entries, rationality), rel=1e-9)
                weight = np.log(np.sum(measures * np.exp(-rationality * (costs - least)))) - rationality * least
                assert found[LOG_WEIGHT] == pytest.approx(weight, abs=1e-8)


@pytest.mark.parametrize("person", ["MN", "MP", "GN", "GP", "blind", "farsighted", "300"])
@pytest.mark.parametrize("with_goal", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_objectives_of_real_grasps_are_those_of_the_plain_loops(name, with_goal, person):
    """From the object's pose to expected cost, mean, feasibility and probabilities, with a table at the goal.

    Some grasps are out of reach, some cannot be placed, some are blocked.
    """
    model = {
        "blind": ChoiceModel("blind", 0.0, 0.5),
        "farsighted": ChoiceModel("farsighted", 8.0, 0.0),
        "300": ChoiceModel("300", 300.0, 0.7),
    }.get(person) or person_model(person)
    grasps, poses, goals = case(name)
    taker = taker_of(grasps.sides)
    obstacles = obstacles_of(TABLE, np.eye(4))
    allowed = np.random.default_rng(6).random((3, len(grasps))) < 0.7
    allowed[0] = True
    table = statistics(taker, grasps, poses, model.hand_rationality)
    goal, there = GoalCosts(), [None] * len(grasps)
    if with_goal:
        goal = GoalCosts(statistics(taker, grasps, goals[0], model.rationality, obstacles)[0], REGRASP)
        there = SAMPLED(name, "goal", lambda: ways(taker, grasps, goals[0], obstacles))
    hands = SAMPLED(name, "hand", lambda: [ways(taker, grasps, pose) for pose in poses])
    for index, sets in enumerate(hands):
        for row, mask in enumerate(allowed):
            loops = [plain.Grasp(h if free else [], g) for h, g, free in zip(sets, there, mask)]
            expected = {
                "expected_cost": plain.expected_cost(loops, model, REGRASP),
                "minimum_mean": plain.minimum_mean(loops, REGRASP),
                "maximum_feasibility": plain.maximum_feasibility(loops),
            }
            for objective, value in expected.items():
                found = OBJECTIVES[objective](table[index : index + 1], goal, model, mask[None])[0, 0]
                assert found == pytest.approx(value, rel=1e-9, abs=1e-9), (objective, index, row)
            chances = [sum(p) for p in plain.joint_probabilities(loops, model, REGRASP)]
            found = grasp_probabilities(table[index], goal, model, mask)
            np.testing.assert_allclose(found, chances, atol=1e-9)


class Samples(dict):
    """Sampled configurations, kept: the loops in Python are slow."""

    def __call__(self, name, kind, make):
        if (name, kind) not in self:
            self[name, kind] = make()
        return self[name, kind]


SAMPLED = Samples()


@pytest.mark.parametrize("name", CASES)
def test_the_cases_are_not_trivial(name):
    """Some grasps are in reach; obstacles at the goal take some of a mug away, where the loops see the same."""
    grasps, poses, goals = case(name)
    taker, obstacles = taker_of(grasps.sides), obstacles_of(TABLE, np.eye(4))
    measure = statistics(taker, grasps, poses, 1.0)[..., MEASURE]
    assert (measure.max(axis=1) > 0.0).all()
    bare = statistics(taker, grasps, goals[0], 1.0)[0, :, MEASURE]
    narrow = statistics(taker, grasps, goals[0], 1.0, obstacles)[0, :, MEASURE]
    assert (narrow <= bare + 1e-12).all()
    if name.startswith("mug"):
        assert narrow.sum() < bare.sum()
    for entries, found in zip(ways(taker, grasps, goals[0], obstacles), narrow, strict=True):
        assert sum(m for m, _ in entries) == pytest.approx(found, rel=1e-9)


def test_the_expected_cost_moves_along_with_the_whole_scene():
    """Person and object turned and moved together cost the same, to rounding."""
    grasps, poses, _ = case("mug, right hand")
    taker, model = taker_of(("right",)), person_model("MN")
    allowed = np.ones((1, len(grasps)), dtype=bool)
    rng = np.random.default_rng(2)
    values = []
    for moved in (np.eye(4), make_transform(Rotation.random(random_state=3).as_matrix(), rng.normal(size=3))):
        torso = moved @ transform_from_xyz_rpy([1.0, 2.0, 1.4], [0.0, 0.0, 0.7])
        objects = moved @ transform_from_xyz_rpy([1.0, 2.0, 1.4], [0.0, 0.0, 0.7]) @ poses
        table = statistics(taker, grasps, invert_transform(torso) @ objects, model.hand_rationality)
        values.append(expected_cost(table, GoalCosts(), model, allowed))
    np.testing.assert_allclose(values[1], values[0], rtol=1e-6)


def test_many_poses_are_each_alone():
    """A pose has the statistics it has among others, and no pose gives an empty table."""
    grasps, poses, _ = case("mug, either hand")
    taker = taker_of(("right", "left"))
    many = statistics(taker, grasps, poses, 5.0)
    for pose, table in zip(poses, many, strict=True):
        np.testing.assert_array_equal(statistics(taker, grasps, pose, 5.0)[0], table)
    assert statistics(taker, grasps, np.empty((0, 4, 4)), 5.0).shape == (0, len(grasps), 5)


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_hand_without_a_grasp_left_does_not_count(side):
    """A subset with grasps of one hand only has the statistics that these grasps had, also when the other has none."""
    grasps, poses, _ = case("mug, either hand")
    taker = taker_of(("right", "left"))
    kept = grasps.hands[:, grasps.sides.index(side)] >= 0
    subset = grasps.subset(kept)
    for obstacles in (None, obstacles_of(TABLE, np.eye(4))):
        whole = statistics(taker, grasps, poses, 5.0, obstacles)
        np.testing.assert_array_equal(statistics(taker, subset, poses, 5.0, obstacles), whole[:, kept])


def test_two_hands_need_both():
    """Where one hand cannot reach there is no way to take the object."""
    grasps = grasp_set(load_object("box"), ("right", "left"))
    far = transform_from_xyz_rpy([0.35, 0.75, -0.3])
    table = statistics(taker_of(("right", "left")), grasps, far, 10.0)[0]
    assert not table[:, MEASURE].any()
    assert not np.isnan(table).any()


def test_a_person_needs_a_cost_for_each_arm():
    """An arm without a cost, or no arm, is refused."""
    with pytest.raises(BadRequestError, match="cost for each arm"):
        Taker(ARMS, {"right": load_arm_cost("rula", ARMS["right"], PREFERENCE)})
    with pytest.raises(BadRequestError, match="cost for each arm"):
        Taker({}, {})
    assert taker_of(("left", "right")).sides == ("left", "right")


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("cost", ["squared_distance", "gravity_torque"])
def test_grasps_each_at_a_pose_of_its_own_are_weighed_as_one_by_one(name, cost):
    """Each grasp with its pose and the table as seen from there is what all grasps are at that pose."""
    grasps, poses, _ = case(name)
    taker = taker_of(CASES[name][1], cost)
    which = np.arange(len(grasps)) % len(poses)
    seen = [obstacles_of(TABLE, transform_from_xyz_rpy([0.0, 0.0, 0.1 * n], [0.0] * 3)) for n in range(len(poses))]
    for obstacles in (seen, []):
        found = statistics_each(taker, grasps, poses[which], 3.0, obstacles, which)
        for grasp, place in enumerate(which):
            there = obstacles[place] if obstacles else None
            one = statistics(taker, grasps, poses[place], 3.0, there)[0, grasp]
            np.testing.assert_allclose(found[grasp], one, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rationality", [0.0, 10.0, 300.0, np.inf])
def test_posture_probabilities_are_the_share_of_each_way(rationality):
    """And with them the mean cost is that of the table the planner decides by."""
    taker = taker_of(("right",))
    grasps, poses, _ = case("mug, right hand")
    table = statistics(taker, grasps, poses, rationality)
    checked = 0
    for number, pose in enumerate(poses):
        for grasp in range(len(grasps)):
            hand = pose @ grasps.hand_poses(grasp)["right"]
            postures, shares = posture_probabilities(taker, "right", hand, rationality)
            found = configurations(taker, "right", hand)
            assert len(shares) == len(found)
            if not found:
                continue
            least = min(cost for _, cost in found)
            plain = np.array(
                [
                    float(cost == least) if np.isinf(rationality) else measure * np.exp(-rationality * (cost - least))
                    for measure, cost in found
                ]
            )
            np.testing.assert_allclose(shares, plain / plain.sum(), atol=1e-12)
            if np.isfinite(rationality):
                mean = shares @ taker.costs["right"].evaluate(postures)
                assert mean == pytest.approx(table[number, grasp, MEAN], rel=1e-9)
            checked += 1
    assert checked > 10
