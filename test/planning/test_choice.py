"""How a person chooses a grasp: against the plain loops, and what must hold of any choice."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.arm.inverse_kinematics import FeasibleSets, weigh
from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.planning import choice_reference as plain
from handover_ros.planning.choice import ChoiceModel, GoalCosts, grasp_probabilities, perceived, person_model

REGRASP = 2.0  # costs times 300 must not underflow in the plain loops
PERSONS = ["MN", "MP", "GN", "GP"]
seeds = st.integers(0, 10**6)
myopias = st.one_of(st.sampled_from([0.0, 0.5, 1.0]), st.floats(1e-3, 1.0))
rationalities = st.one_of(st.sampled_from([0.0, 300.0, np.inf]), st.floats(0.0, 300.0))
models = st.builds(lambda r, m: ChoiceModel("any", r, m), rationalities, myopias)
goals = st.sampled_from(["none", "all", "some"])


def configurations(rng, least):
    return [(float(rng.uniform(0.05, 1.0)), float(rng.uniform(0.0, 2.0))) for _ in range(rng.integers(least, 5))]


def problem(seed, goal, least=0):
    """Return up to five grasps; a goal is absent, possible with all, or not possible with some of them."""
    rng = np.random.default_rng(seed)
    fewest = {"all": 1, "some": 0}
    return [
        plain.Grasp(configurations(rng, least), None if goal == "none" else configurations(rng, fewest[goal]))
        for _ in range(rng.integers(1, 6))
    ]


def table_of(sets, rationality):
    """Return the table of lists of (measure, cost)."""
    flat = np.array([entry for entries in sets for entry in entries]).reshape(-1, 2)
    first = np.concatenate([[0], np.cumsum([len(entries) for entries in sets])]).astype(np.int64)
    return weigh(FeasibleSets(np.zeros((len(flat), 7)), flat[:, 0].copy(), first), flat[:, 1], rationality)


def tables_of(grasps, model, regrasp=REGRASP):
    goal = GoalCosts()
    if grasps[0].goal is not None:
        goal = GoalCosts(table_of([grasp.goal for grasp in grasps], model.rationality), regrasp)
    return table_of([grasp.hand for grasp in grasps], model.hand_rationality), goal


def probabilities_of(grasps, model, allowed=None):
    return grasp_probabilities(*tables_of(grasps, model), model, allowed)


def mask_of(seed, count):
    return np.random.default_rng([seed, 1]).random(count) < 0.7


def blocked(grasps, allowed):
    return [plain.Grasp(g.hand if free else [], g.goal) for g, free in zip(grasps, allowed)]


@settings(max_examples=300, deadline=None)
@given(seeds, goals, models, st.booleans())
def test_probabilities_are_those_of_the_plain_loops(seed, goal, model, masked):
    """P(g) is the sum of P(g, q) over the configurations of a grasp, whatever is infeasible or blocked."""
    grasps = problem(seed, goal)
    allowed = mask_of(seed, len(grasps)) if masked else None
    open_ones = grasps if allowed is None else blocked(grasps, allowed)
    expected = [sum(p) for p in plain.joint_probabilities(open_ones, model, REGRASP)]
    np.testing.assert_allclose(probabilities_of(grasps, model, allowed), expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", PERSONS)
@pytest.mark.parametrize("goal", ["none", "all", "some"])
def test_the_four_persons_are_those_of_the_plain_loops(name, goal):
    """MN, MP, GN and GP choose as the loops do."""
    for seed in range(20):
        grasps, model = problem(seed, goal), person_model(name)
        expected = [sum(p) for p in plain.joint_probabilities(grasps, model, REGRASP)]
        np.testing.assert_allclose(probabilities_of(grasps, model), expected, rtol=0.0, atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(seeds, goals, models)
def test_probabilities_sum_to_one_or_are_all_zero(seed, goal, model):
    """Somebody takes the object if any grasp is feasible and free, for any shape of mask."""
    grasps = problem(seed, goal)
    allowed = np.random.default_rng(seed).random((4, len(grasps))) < 0.5
    result = probabilities_of(grasps, model, allowed)
    possible = (allowed & np.array([bool(g.hand) for g in grasps])).any(axis=1)
    np.testing.assert_allclose(result.sum(axis=1), possible.astype(float), atol=1e-12)
    assert (result >= 0.0).all()
    assert not result[~allowed].any()


@settings(max_examples=100, deadline=None)
@given(seeds, goals, models, st.integers(0, 5))
def test_an_infeasible_grasp_changes_nothing(seed, goal, model, place):
    """The other probabilities stay, wherever a grasp that nobody can reach is put."""
    grasps = problem(seed, goal)
    place = min(place, len(grasps))
    more = [*grasps[:place], plain.Grasp([], None if goal == "none" else [(1.0, 0.0)]), *grasps[place:]]
    with_it = probabilities_of(more, model)
    assert with_it[place] == 0.0
    np.testing.assert_allclose(np.delete(with_it, place), probabilities_of(grasps, model), atol=1e-15)


@settings(max_examples=100, deadline=None)
@given(seeds, rationalities)
def test_a_myopic_person_ignores_the_goal(seed, rationality):
    """With gamma = 1 the probabilities are those without a goal."""
    grasps, model = problem(seed, "some"), ChoiceModel("any", rationality, 1.0)
    without = [plain.Grasp(g.hand) for g in grasps]
    np.testing.assert_allclose(probabilities_of(grasps, model), probabilities_of(without, model), atol=1e-15)


@settings(max_examples=100, deadline=None)
@given(seeds, rationalities)
def test_a_person_with_the_goal_in_mind_ignores_the_hand(seed, rationality):
    """With gamma = 0 what the postures at the handover cost does not matter."""
    rng = np.random.default_rng(seed)
    grasps, model = problem(seed, "all"), ChoiceModel("any", rationality, 0.0)
    others = [plain.Grasp([(m, float(rng.uniform(0.0, 9.0))) for m, _ in g.hand], g.goal) for g in grasps]
    np.testing.assert_allclose(probabilities_of(grasps, model), probabilities_of(others, model), atol=1e-15)


@settings(max_examples=100, deadline=None)
@given(seeds, goals, models, st.floats(0.0, 1e6))
def test_only_differences_of_costs_count(seed, goal, model, constant):
    """A constant on top of all costs leaves the probabilities, also where exp(-rationality C) is zero."""
    grasps = problem(seed, goal, least=1)
    dearer = [plain.Grasp([(m, c + constant) for m, c in g.hand], None if g.goal is None else g.goal) for g in grasps]
    result = probabilities_of(dearer, model)
    assert result.sum() == pytest.approx(1.0)
    if not model.is_perfect:  # the costs themselves are only as exact as the constant lets them be
        tolerance = 1e-12 + 1e-14 * constant * model.rationality
        np.testing.assert_allclose(result, probabilities_of(grasps, model), atol=tolerance)


def test_a_very_rational_person_at_high_costs_still_chooses():
    """At rationality 300 and costs of 100 every weight underflows, the odds do not."""
    model = ChoiceModel("any", 300.0, 1.0)
    grasps = [plain.Grasp([(1.0, 100.0)]), plain.Grasp([(1.0, 100.01)]), plain.Grasp([(1.0, 200.0)])]
    odds = np.exp([0.0, -3.0, -np.inf])
    np.testing.assert_allclose(probabilities_of(grasps, model), odds / odds.sum(), rtol=1e-9)


@pytest.mark.parametrize("myopia", [0.0, 0.3, 0.5, 1.0])
def test_a_perfect_person_takes_the_best_and_shares_ties_by_measure(myopia):
    """Of equally good grasps each is as likely as the measure of its best configurations; the worse have none."""
    model = ChoiceModel("perfect", np.inf, myopia)
    later = [(1.0, 0.5)]
    grasps = [
        plain.Grasp([(0.25, 1.0), (9.0, 1.0 if myopia == 0.0 else 2.0)], later),
        plain.Grasp([(0.5, 1.0), (0.25, 1.0)], later),
        plain.Grasp([(7.0, 1.5)], [(1.0, 4.0)]),
    ]
    first = 9.25 if myopia == 0.0 else 0.25
    expected = np.array([first, 0.75, 0.0]) / (first + 0.75)
    np.testing.assert_allclose(probabilities_of(grasps, model), expected, atol=1e-12)


@pytest.mark.parametrize("name", PERSONS)
def test_nobody_chooses_what_is_blocked(name):
    """With every grasp blocked, or none in reach, all probabilities are zero: also of a perfect person."""
    model = person_model(name)
    grasps = problem(3, "all", least=1)
    assert not probabilities_of(grasps, model, np.zeros(len(grasps), dtype=bool)).any()
    assert not probabilities_of(blocked(grasps, [False] * len(grasps)), model).any()


def test_more_rational_persons_are_nearer_to_the_perfect_one():
    """The noisy person's probabilities tend to the perfect person's."""
    rng = np.random.default_rng(11)
    grasps = [plain.Grasp(configurations(rng, 1), configurations(rng, 1)) for _ in range(6)]
    perfect = probabilities_of(grasps, ChoiceModel("p", np.inf, 0.5))
    away = [np.abs(probabilities_of(grasps, ChoiceModel("n", r, 0.5)) - perfect).sum() for r in (1.0, 30.0, 1e5)]
    assert away[0] > away[1] > away[2]
    assert away[2] < 1e-3


def test_the_perceived_cost_of_a_perfect_person_is_weighted():
    """perceived() is minus gamma C(hand) - (1 - gamma) C(goal), the regrasp where the goal is out of reach (3.5)."""
    model = ChoiceModel("perfect", np.inf, 0.25)
    grasps = [plain.Grasp([(1.0, 2.0)], [(1.0, 4.0)]), plain.Grasp([(1.0, 2.0)], []), plain.Grasp([], [(1.0, 0.0)])]
    np.testing.assert_allclose(perceived(*tables_of(grasps, model, 8.0), model), [-3.5, -6.5, -np.inf])


@pytest.mark.parametrize(
    ("rationality", "myopia", "word"),
    [(-1.0, 0.5, "rationality"), (np.nan, 0.5, "rationality"), (1.0, 1.1, "myopia"), (1.0, np.nan, "myopia")],
)
def test_impossible_persons_are_refused(rationality, myopia, word):
    """The message names the number that is out of range."""
    with pytest.raises(BadRequestError, match=word):
        ChoiceModel("any", rationality, myopia)


def test_persons_have_the_numbers_of_section_3_5():
    """M is gamma 1, G is 0.5; N is noisy with the given rationality, P is perfect."""
    found = {name: person_model(name, 7.0) for name in PERSONS}
    assert [found[n].myopia for n in PERSONS] == [1.0, 1.0, 0.5, 0.5]
    assert [found[n].is_perfect for n in PERSONS] == [False, True, False, True]
    assert found["MN"].rationality == found["GN"].rationality == 7.0
    with pytest.raises(UnknownNameError, match="GN, GP, MN, MP"):
        person_model("XX")
