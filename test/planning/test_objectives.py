"""What a handover is judged by: the three objectives against the plain loops, and what must hold of them."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.arm.inverse_kinematics import FeasibleSets, weigh
from handover_ros.planning import choice_reference as plain
from handover_ros.planning.choice import MEAN, ChoiceModel, GoalCosts, person_model
from handover_ros.planning.objectives import OBJECTIVES, expected_cost

REGRASP = 2.0  # costs times 300 must not underflow in the plain loops
seeds = st.integers(0, 10**6)
myopias = st.one_of(st.sampled_from([0.0, 0.5, 1.0]), st.floats(1e-3, 1.0))
rationalities = st.one_of(st.sampled_from([0.0, 300.0, np.inf]), st.floats(0.0, 300.0))
models = st.builds(lambda r, m: ChoiceModel("any", r, m), rationalities, myopias)
goals = st.sampled_from(["none", "all", "some"])


def configurations(rng, least, most=5):
    return [(float(rng.uniform(0.05, 1.0)), float(rng.uniform(0.0, 2.0))) for _ in range(rng.integers(least, most))]


def scene(seed, goal, poses=3, least=0, most=5):
    """Return hands (configurations of every pose and grasp), goal (of every grasp, or Nones) and a mask (4, grasps)."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 6))
    hands = [[configurations(rng, least, most) for _ in range(count)] for _ in range(poses)]
    there = [None if goal == "none" else configurations(rng, {"all": 1, "some": 0}[goal]) for _ in range(count)]
    allowed = rng.random((4, count)) < 0.7
    allowed[0] = True
    return hands, there, allowed


def table_of(sets, rationality):
    flat = np.array([entry for entries in sets for entry in entries]).reshape(-1, 2)
    first = np.concatenate([[0], np.cumsum([len(entries) for entries in sets])]).astype(np.int64)
    return weigh(FeasibleSets(np.zeros((len(flat), 7)), flat[:, 0].copy(), first), flat[:, 1], rationality)


def values_of(objective, hands, there, allowed, model):
    """Return an objective's values (poses, masks)."""
    table = np.stack([table_of(sets, model.hand_rationality) for sets in hands])
    goal = GoalCosts() if there[0] is None else GoalCosts(table_of(there, model.rationality), REGRASP)
    return objective(table, goal, model, allowed)


def plain_values(name, hands, there, allowed, model):
    """Return the same by the plain loops, one pose and mask after the other."""
    result = np.empty((len(hands), len(allowed)))
    for row, sets in enumerate(hands):
        for column, mask in enumerate(allowed):
            grasps = [plain.Grasp(h if free else [], g) for h, g, free in zip(sets, there, mask)]
            result[row, column] = {
                "expected_cost": lambda grasps=grasps: plain.expected_cost(grasps, model, REGRASP),
                "minimum_mean": lambda grasps=grasps: plain.minimum_mean(grasps, REGRASP),
                "maximum_feasibility": lambda grasps=grasps: plain.maximum_feasibility(grasps),
            }[name]()
    return result


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(sorted(OBJECTIVES)), seeds, goals, models)
def test_objectives_are_those_of_the_plain_loops(name, seed, goal, model):
    """All poses and masks at once give what one loop for each gives, infeasible ones included."""
    hands, there, allowed = scene(seed, goal)
    expected = plain_values(name, hands, there, allowed, model)
    np.testing.assert_allclose(
        values_of(OBJECTIVES[name], hands, there, allowed, model), expected, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("person", ["MN", "MP", "GN", "GP"])
@pytest.mark.parametrize("goal", ["none", "all", "some"])
@pytest.mark.parametrize("name", sorted(OBJECTIVES))
def test_objectives_of_the_four_persons_are_those_of_the_plain_loops(name, goal, person):
    """MN, MP, GN and GP, with and without a goal."""
    for seed in range(15):
        hands, there, allowed = scene(seed, goal)
        expected = plain_values(name, hands, there, allowed, person_model(person))
        found = values_of(OBJECTIVES[name], hands, there, allowed, person_model(person))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rationality", [0.0, 10.0, 300.0, np.inf])
@pytest.mark.parametrize("name", sorted(OBJECTIVES))
def test_what_nobody_can_take_is_infinitely_bad(name, rationality):
    """With all grasps out of reach, or all blocked, every objective is infinite, for noisy and perfect persons."""
    model = ChoiceModel("any", rationality, 0.5)
    for there in ([[(1.0, 1.0)], [(1.0, 2.0)]], [None, None]):
        reached, not_reached = [[(1.0, 1.0)], [(1.0, 2.0)]], [[], []]
        allowed = np.array([[True, True], [False, False]])
        found = values_of(OBJECTIVES[name], [reached, not_reached], there, allowed, model)
        assert np.isfinite(found[0, 0])
        assert (found.ravel()[1:] == np.inf).all()


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(sorted(OBJECTIVES)), seeds, goals, models)
def test_an_infeasible_grasp_changes_no_objective(name, seed, goal, model):
    """A grasp that nobody can reach at the handover adds nothing, however good it were at the goal."""
    hands, there, allowed = scene(seed, goal)
    more = [[*sets, []] for sets in hands]
    after = [*there, None if goal == "none" else [(5.0, 0.0)]]
    wider = np.column_stack([allowed, np.ones(len(allowed), dtype=bool)])
    np.testing.assert_allclose(
        values_of(OBJECTIVES[name], more, after, wider, model),
        values_of(OBJECTIVES[name], hands, there, allowed, model),
        rtol=1e-12,
    )


@settings(max_examples=100, deadline=None)
@given(seeds, goals, models)
def test_expected_cost_is_at_least_the_least_cost(seed, goal, model):
    """No person pays less than the cheapest way to take the object and then place it."""
    hands, there, allowed = scene(seed, goal, least=1)
    found = values_of(expected_cost, hands, there, allowed, model)
    later = [0.0 if g is None else min((c for _, c in g), default=REGRASP) for g in there]
    for row, sets in enumerate(hands):
        for column, mask in enumerate(allowed):
            costs = [min(c for _, c in h) + after for h, after, free in zip(sets, later, mask) if free]
            assert found[row, column] >= min(costs, default=np.inf) - 1e-12


@settings(max_examples=100, deadline=None)
@given(seeds, st.lists(st.floats(0.0, 300.0), min_size=2, max_size=5))
def test_without_a_goal_the_more_rational_pay_less(seed, values):
    """The expected cost at the handover falls with the rationality, down to the perfect person's least cost."""
    hands, there, allowed = scene(seed, "none", least=1)
    costs = [
        values_of(expected_cost, hands, there, allowed, ChoiceModel("any", r, 1.0)) for r in [*sorted(values), np.inf]
    ]
    for dearer, cheaper in pairwise(costs):
        assert (cheaper <= dearer + 1e-9).all()
    least = [min(c for entries in sets for _, c in entries) for sets in hands]
    np.testing.assert_allclose(costs[-1][:, 0], least, atol=1e-12)


@settings(max_examples=100, deadline=None)
@given(seeds, st.lists(st.floats(0.0, 300.0), min_size=2, max_size=5))
def test_with_one_way_to_place_each_grasp_a_rational_global_person_pays_less(seed, values):
    """gamma = 0.5 perceives half of what is paid (3.4, 3.5): where the goal leaves no choice, rationality saves."""
    hands, there, allowed = scene(seed, "all", least=1)
    there = [entries[:1] for entries in there]
    costs = [
        values_of(expected_cost, hands, there, allowed, ChoiceModel("any", r, 0.5)) for r in [*sorted(values), np.inf]
    ]
    for dearer, cheaper in pairwise(costs):
        assert (cheaper <= dearer + 1e-9).all()


def test_a_perfect_global_person_takes_the_least_total():
    """GP pays the least sum, MP the least at the handover and whatever comes with it."""
    hands, there = [[[(1.0, 1.0)], [(1.0, 1.5)]]], [[(1.0, 3.0)], [(1.0, 0.5)]]
    allowed = np.ones((1, 2), dtype=bool)
    assert values_of(expected_cost, hands, there, allowed, person_model("GP"))[0, 0] == pytest.approx(2.0)
    assert values_of(expected_cost, hands, there, allowed, person_model("MP"))[0, 0] == pytest.approx(4.0)


def test_grasps_that_cannot_be_placed_cost_the_regrasp():
    """A single grasp whose goal is out of reach costs its hand and the regrasp."""
    hands, there = [[[(1.0, 1.0)]]], [[]]
    allowed = np.ones((1, 1), dtype=bool)
    for name in ("expected_cost", "minimum_mean"):
        assert values_of(OBJECTIVES[name], hands, there, allowed, person_model("GN"))[0, 0] == pytest.approx(3.0)


def test_a_blind_person_pays_the_plain_mean():
    """At rationality 0 and without a goal the expected cost is the mean of all configurations alike."""
    hands, there, allowed = scene(5, "none", least=1)
    blind = ChoiceModel("blind", 0.0, 1.0)
    np.testing.assert_allclose(
        values_of(expected_cost, hands, there, allowed, blind),
        values_of(OBJECTIVES["minimum_mean"], hands, there, allowed, blind),
        rtol=1e-12,
    )


def test_feasibility_rewards_every_way_to_take_and_to_place():
    """Minus the measures at the handover and, of grasps feasible there, at the goal."""
    hands, there = [[[(1.0, 1.0), (0.5, 9.0)], []]], [[(0.25, 0.0)], [(8.0, 0.0)]]
    found = values_of(OBJECTIVES["maximum_feasibility"], hands, there, np.ones((1, 2), dtype=bool), person_model("MN"))
    assert found[0, 0] == pytest.approx(-1.75)


def test_a_weighted_mean_does_not_depend_on_the_poses_beside_it():
    """One pose alone has the value it has among others."""
    hands, there, allowed = scene(8, "some")
    model = person_model("GN")
    together = values_of(expected_cost, hands, there, allowed, model)
    for row, sets in enumerate(hands):
        np.testing.assert_array_equal(values_of(expected_cost, [sets], there, allowed, model)[0], together[row])


def test_mean_of_an_infeasible_grasp_never_leaks():
    """The table of an infeasible grasp has no finite mean, and the expected cost is finite all the same."""
    table = table_of([[(1.0, 1.0)], []], 10.0)
    assert np.isinf(table[1, MEAN])
    value = expected_cost(table[None], GoalCosts(), person_model("MN"), np.ones((1, 2), dtype=bool))
    assert value[0, 0] == pytest.approx(1.0)
