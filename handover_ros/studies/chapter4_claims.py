"""The claims of chapter 4, each settled by a test of what the simulated persons did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.studies.chapter4 import ARTIFICIAL, USERS
from handover_ros.studies.claims import Claim, for_people, settled
from handover_ros.studies.statistics import Comparison, Direction, against, correlated, independent, paired
from handover_ros.studies.tables import Rows, column, curves, only, shares

CHAPTER = 4
ARMS = {"planar": "planar 2-DoF arm", "arm": "7-DoF arm"}
LEARNED = {"neutral": "neutral posture q*", "weights": "joint weights w"}
# Measure: what it is called, and which direction is better.
MEASURES: Mapping[str, tuple[str, Direction]] = {
    "log_density": ("log P(lambda*)", "greater"),
    "distance": ("distance of the mode to lambda*", "less"),
    "test_log_likelihood": ("test log likelihood", "greater"),
}
EARLY = 2  # iterations of the user study in which active was ahead
CLOSE = 0.5  # least share of the early lead that must be gone for the two to be close
TABLE = {
    "prefer": ("'I prefer Program --'", "active 3.4, passive 4.4 (of 5)"),
    "helpful": ("'The robot was helpful'", "active 4.6, passive 4.6"),
    "easy": ("'It was physically easy to do the task'", "active 4.8, passive 4.8"),
    "easier": ("'The robot handed me objects in a way that made the task easier'", "active 4.8, passive 4.6"),
    "choice": ("forced choice of a program", "active 20 %, passive 80 %"),
}


def claims(tables: Mapping[str, Rows], objects: Sequence[str]) -> list[Claim]:
    """Return all claims of the chapter.

    Args:
        tables: ``learning``, ``feasible_sets`` and ``likelihoods``, as the units found them.
        objects: The two real objects, the one that is claimed to tell more first.
    """
    rows, sets = tables["learning"], tables["feasible_sets"]
    found = []
    for arm in ARMS:
        for learned in LEARNED:
            found += _learning(rows, arm, learned)
            found.append(_cost(rows, arm, learned))
    found += [_weights_gap(rows), _passive_stays(rows), _both_learn(rows), _alternates(rows)]
    found += _feasible_sets(sets, tables["likelihoods"])
    found += _chosen_sets(rows)
    found.append(_worse_than_first(rows))
    found += _objects(rows, sets, objects)
    found += _users(rows, objects)
    return found + [
        for_people(f"users_{name}", CHAPTER, f"Table 4.1, {text}", said) for name, (text, said) in TABLE.items()
    ]


def over_course(rows: Rows, scenario: str, strategy: str, measure: str) -> FloatArray:
    """Return each person's mean of a measure over all iterations (people,), so that what comes early counts more."""
    return np.asarray(curves(rows, scenario, strategy, measure)[:, 1:].mean(axis=1))


def _learning(rows: Rows, arm: str, learned: str) -> list[Claim]:
    """Return the claims that active learns faster than passive and random, by three measures."""
    scenario, found = f"{arm}_{learned}", []
    queries = curves(rows, scenario, "active", "distance").shape[1] - 1
    for measure, (name, direction) in MEASURES.items():
        values = {each: over_course(rows, scenario, each, measure) for each in ("active", "passive", "random")}
        comparisons = [paired(values["active"], values[other], direction) for other in ("passive", "random")]
        means = ", ".join(f"{each} {value.mean():.2f}" for each, value in values.items())
        found.append(
            settled(
                f"{scenario}_{measure}",
                CHAPTER,
                f"{ARMS[arm]}, {LEARNED[learned]}: active learns faster than passive and random: {name}, "
                f"mean of queries 1 to {queries}",
                f"figure {'4.2' if arm == 'planar' else '4.8'}: active best on all three measures",
                f"{means}; active less passive {comparisons[0].told()}; active less random {comparisons[1].told()}",
                comparisons,
            )
        )
    return found


def _cost(rows: Rows, arm: str, learned: str) -> Claim:
    """Return the claim that passive costs the person least while it learns."""
    scenario = f"{arm}_{learned}"
    values = {each: over_course(rows, scenario, each, "true_cost") for each in ("active", "passive", "random")}
    comparisons = [paired(values["passive"], values[other], "less") for other in ("active", "random")]
    means = ", ".join(f"{each} {value.mean():.2f}" for each, value in values.items())
    return settled(
        f"{scenario}_cost",
        CHAPTER,
        f"{ARMS[arm]}, {LEARNED[learned]}: passive has the lowest true expected cost of its queries",
        f"figure {'4.2' if arm == 'planar' else '4.8'}: passive lowest, active suffers a loss",
        f"{means}; passive less active {comparisons[0].told()}; passive less random {comparisons[1].told()}",
        comparisons,
    )


def _weights_gap(rows: Rows) -> Claim:
    """Return the claim that active leads passive by more when weights are learned."""
    gaps = {}
    for learned in LEARNED:
        last = {
            each: curves(rows, f"planar_{learned}", each, "log_density")[:, [0, -1]] for each in ("active", "passive")
        }
        gaps[learned] = last["active"][:, 1] - last["passive"][:, 1]
    found = independent(gaps["weights"], gaps["neutral"], "greater")
    return settled(
        "planar_weights_gap",
        CHAPTER,
        "Planar arm: active leads passive by more for w than for q* (log P(lambda*) after the last query)",
        "figure 4.2: particularly large for the weights",
        f"lead {gaps['weights'].mean():.2f} nat for w, {gaps['neutral'].mean():.2f} nat for q*; {found.told(' nat')}",
        [found],
    )


def _passive_stays(rows: Rows) -> Claim:
    """Return the claim that passive does not come to the right weights: it gains less than half of active's."""
    gains = {}
    for strategy in ("active", "passive"):
        table = curves(rows, "planar_weights", strategy, "log_density")
        gains[strategy] = table[:, -1] - table[:, 0]
    found = against(gains["passive"] - 0.5 * gains["active"], 0.0, "less", "paired t-test of passive - active / 2")
    return settled(
        "planar_weights_passive",
        CHAPTER,
        "Planar arm: passive fails to converge to the right w (gains less than half of active's log P(lambda*))",
        "figure 4.2: fails to converge even after many iterations",
        f"gain of active {gains['active'].mean():.2f}, of passive {gains['passive'].mean():.2f} nat; {found.told()}",
        [found],
    )


def _both_learn(rows: Rows) -> Claim:
    """Return the claim that passive too learns better than random."""
    comparisons, told = [], []
    for learned in LEARNED:
        scenario = f"planar_{learned}"
        passive, random = (over_course(rows, scenario, each, "log_density") for each in ("passive", "random"))
        comparisons.append(paired(passive, random, "greater"))
        told.append(f"{LEARNED[learned]}: passive less random {comparisons[-1].told()}")
    return settled(
        "planar_passive_over_random",
        CHAPTER,
        "Planar arm: passive too is better than random (log P(lambda*), mean of all queries, q* and w)",
        "section 4.5: 'both methods are better than random query selection'",
        "; ".join(told),
        comparisons,
    )


def _alternates(rows: Rows) -> Claim:
    """Return the claim that active alternates between two sets that tell of different directions."""
    places = curves(rows, ARTIFICIAL, "active", "place")[:, 1:]
    share = (np.diff(places, axis=1) != 0.0).mean(axis=1)
    found = against(share, 0.5, "greater")
    return settled(
        "artificial_alternation",
        CHAPTER,
        "Two artificial feasible sets: active alternates between them (more often than half of the time)",
        "figure 4.4: alternates",
        f"changes in {100.0 * share.mean():.0f} % of the queries; over one half by {found.told()}",
        [found],
    )


def _feasible_sets(sets: Rows, likelihoods: Rows) -> list[Claim]:
    """Return the claims on what makes a feasible set informative, and that shape and pose of objects matter."""
    planar = only(sets, kind="planar")
    told = column(planar, "information_neutral")
    comparisons = [correlated(column(planar, name), told) for name in ("spread", "parts")]
    found = [
        settled(
            "sets_apart_inform",
            CHAPTER,
            "Planar arm: feasible sets of widely separated parts tell more about q*",
            "section 4.5: sharp gradients, quickly eliminate large pieces of the belief",
            f"correlation of information with spread {comparisons[0].told()}; with the number of parts "
            f"{comparisons[1].told()}; {len(planar)} objects",
            comparisons,
        )
    ]
    for kind, figure in (("shape", "4.5"), ("pose", "4.6")):
        pairs = only(likelihoods, kind=kind)
        difference = paired(column(pairs, "other_object"), column(pairs, "same_object"), "greater")
        found.append(
            settled(
                f"{kind}_matters",
                CHAPTER,
                f"Planar arm: objects that differ only in {kind} make different likelihood functions (total variation, "
                "more than two answers to the same object)",
                f"figure {figure}: vary widely",
                f"{column(pairs, 'other_object').mean():.2f} between objects, "
                f"{column(pairs, 'same_object').mean():.2f} between answers; {difference.told()}",
                [difference],
            )
        )
    return found


def _chosen_sets(rows: Rows) -> list[Claim]:
    """Return the claims on which feasible sets active and passive choose."""
    values = {
        (strategy, name): over_course(rows, "planar_neutral", strategy, name)
        for strategy in ("active", "passive")
        for name in ("spread", "parts", "nearest")
    }
    wide = [paired(values["active", name], values["passive", name], "greater") for name in ("spread", "parts")]
    near = paired(values["passive", "nearest"], values["active", "nearest"], "less")
    return [
        settled(
            "active_chooses_wide",
            CHAPTER,
            "Planar arm, q*: active chooses feasible sets more widely spread and of more parts than passive",
            "figure 4.7: widely separated, disjoint feasible regions",
            f"spread {values['active', 'spread'].mean():.2f} against {values['passive', 'spread'].mean():.2f} rad, "
            f"{wide[0].told(' rad')}; parts {values['active', 'parts'].mean():.2f} against "
            f"{values['passive', 'parts'].mean():.2f}, {wide[1].told()}",
            wide,
        ),
        settled(
            "passive_chooses_near",
            CHAPTER,
            "Planar arm, q*: passive chooses feasible sets that come nearer to the true q* than active's",
            "figure 4.7: at least one configuration close to the optimum",
            f"nearest configuration {values['passive', 'nearest'].mean():.2f} against "
            f"{values['active', 'nearest'].mean():.2f} rad; {near.told(' rad')}",
            [near],
        ),
    ]


def _worse_than_first(rows: Rows) -> Claim:
    """Return the claim on the weights of the 7-DoF arm that passive predicts worse than the initial belief."""
    last = {each: curves(rows, "arm_weights", each, "test_log_likelihood") for each in ("active", "passive")}
    passive = paired(last["passive"][:, -1], last["passive"][:, 0], "less")
    active = paired(last["active"][:, -1], last["passive"][:, -1], "greater")
    return settled(
        "arm_weights_passive_worse",
        CHAPTER,
        "7-DoF arm, w: after the last query passive's test log likelihood is below the initial belief's, and active's "
        "above passive's",
        "section 4.6: passive worse than the initial belief, active acceptable",
        f"initial {last['passive'][:, 0].mean():.2f}, passive {last['passive'][:, -1].mean():.2f} ({passive.told()}), "
        f"active {last['active'][:, -1].mean():.2f} (less passive {active.told()})",
        [passive, active],
    )


def _objects(rows: Rows, sets: Rows, objects: Sequence[str]) -> list[Claim]:
    """Return the claims on the feasible sets of the two objects, and on who chooses which."""
    wide, compact = (only(sets, kind="arm", object=name) for name in objects)
    first, second = objects
    comparisons = [independent(column(wide, name), column(compact, name), "greater") for name in ("spread", "parts")]
    found = [
        settled(
            "arm_sets_apart",
            CHAPTER,
            f"7-DoF arm: {first} make feasible sets more widely spread and of more parts than {second}",
            "figure 4.9: large, multiple disjoint portions, against compact",
            f"spread {column(wide, 'spread').mean():.2f} against {column(compact, 'spread').mean():.2f} rad, "
            f"{comparisons[0].told(' rad')}; parts {column(wide, 'parts').mean():.2f} against "
            f"{column(compact, 'parts').mean():.2f}, {comparisons[1].told()}",
            comparisons,
        )
    ]
    for learned in LEARNED:
        scenario = f"arm_{learned}"
        found.append(_preferred(rows, scenario, objects, f"7-DoF arm, {LEARNED[learned]}"))
    return found


def _preferred(rows: Rows, scenario: str, objects: Sequence[str], where: str) -> Claim:
    """Return the claim that active chooses one object and passive the other, of menus with as many of each."""
    share = {each: shares(rows, scenario, each, objects[0]) for each in ("active", "passive")}
    comparisons = [against(share["active"], 0.5, "greater"), against(share["passive"], 0.5, "less")]
    first = [
        100.0
        * np.mean([row["object"] == objects[0] for row in only(rows, scenario=scenario, strategy=each, iteration=1)])
        for each in ("active", "passive")
    ]
    return settled(
        f"{scenario}_objects",
        CHAPTER,
        f"{where}: active prefers {objects[0]}, passive {objects[1]} (half of the menu each)",
        "section 4.7: active the handlebars exclusively, passive only the lock",
        f"{objects[0]} in {100.0 * share['active'].mean():.0f} % of active's and "
        f"{100.0 * share['passive'].mean():.0f} % of passive's queries ({first[0]:.0f} % and {first[1]:.0f} % of the "
        f"first ones); over one half by {comparisons[0].told()} and {comparisons[1].told()}",
        comparisons,
    )


def _users(rows: Rows, objects: Sequence[str]) -> list[Claim]:
    """Return the claims of the user study that simulated persons can settle."""
    active, passive = (curves(rows, USERS, each, "test_log_likelihood")[:, 1:] for each in ("active", "passive"))
    lead = active - passive
    early = against(lead[:, :EARLY].mean(axis=1), 0.0, "greater", "paired t-test")
    gone = against(lead[:, -1] - CLOSE * lead[:, :EARLY].mean(axis=1), 0.0, "less", "paired t-test of last - early / 2")
    comparisons: tuple[Comparison, ...] = (early, gone)
    told = ", ".join(f"{value:+.2f}" for value in lead.mean(axis=0))
    return [
        settled(
            "users_early",
            CHAPTER,
            f"Simulated user study, grasp regions only: active predicts better after the first {EARLY} queries",
            "figure 4.10: higher likelihood for the first two training iterations",
            f"lead of active in test log likelihood by query: {told}; first {EARLY} {early.told()}",
            [early],
        ),
        settled(
            "users_close",
            CHAPTER,
            "Simulated user study: active's lead is there at first and less than half of it after the last query",
            "figure 4.10: after two iterations close to identical",
            f"lead of active by query: {told}; early {early.told()}; last less half of early {gone.told()}",
            comparisons,
        ),
        _preferred(rows, USERS, objects, "Simulated user study"),
    ]
