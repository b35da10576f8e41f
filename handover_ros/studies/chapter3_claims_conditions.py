"""The claims of section 3.5: case studies, the three objectives, and whom the robot should expect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.studies.chapter3_cases import WITH, WITHOUT
from handover_ros.studies.chapter3_settings import PERSONS
from handover_ros.studies.chapter3_tables import beside, costs_by_person
from handover_ros.studies.claims import Claim, settled
from handover_ros.studies.group_statistics import anova, mean_of, told_f, tukey
from handover_ros.studies.statistics import Comparison, against, independent, paired
from handover_ros.studies.tables import Rows, column, only

CHAPTER = 3
OURS, MEAN_COST, OPTIONS = "expected_cost", "minimum_mean", "maximum_feasibility"
BASELINES = {OPTIONS: "maximum feasibility", MEAN_COST: "minimum average cost"}
CLAIMED = {OPTIONS: 3.0, MEAN_COST: 2.0}  # times the expected cost of ours
ATTITUDES = {"any": "Offered in any attitude", "upright": "Offered upright"}


def case_claims(cases: Rows) -> list[Claim]:
    """Return the claims of the case studies, tested over simulated persons."""
    return [_options_are_dangerous(cases), *_great_fair_bad(cases), *_goal_cases(cases)]


def _values(cases: Rows, goal: str, value: str) -> dict[str, FloatArray]:
    """Return a value by objective over persons (n,)."""
    return beside(only(cases, goal=goal), "objective", value, ("person",))


def _told(values: dict[str, FloatArray], digits: int = 2) -> str:
    """Return the means of the three objectives in words."""
    names = {OURS: "expected cost", MEAN_COST: "average cost", OPTIONS: "feasibility"}
    return ", ".join(f"{text} {mean_of(values[name]):.{digits}f}" for name, text in names.items())


def _options_are_dangerous(cases: Rows) -> Claim:
    """Return the claim that the most options cost more, and that the best of them is not as good."""
    expected, least = _values(cases, WITHOUT, "expected_cost"), _values(cases, WITHOUT, "least_hand_cost")
    comparisons = [paired(each[OPTIONS], each[OURS], "greater") for each in (expected, least)]
    return settled(
        "case_feasibility",
        CHAPTER,
        "Case study without goal: maximising options makes the expected cost higher and the best configuration worse",
        "figure 3.2: expected cost rather high, the best configuration not as good",
        f"expected cost by objective: {_told(expected)} ({comparisons[0].told()}); least cost: {_told(least)} "
        f"({comparisons[1].told()}); {len(expected[OURS])} persons",
        comparisons,
    )


def _great_fair_bad(cases: Rows) -> list[Claim]:
    """Return the claims on great, fairly good and bad configurations, against minimum average cost."""
    found = []
    for name, value, direction, text, said in (
        ("great", "great_probability", "greater", "makes a great configuration more probable", "more great choices"),
        ("fair", "fair_probability", "less", "makes a fairly good one less probable", "fewer OK choices (problematic)"),
        ("bad", "bad_measure", "greater", "leaves more bad ones [rad], which nobody takes", "keeps bad (unimportant)"),
    ):
        values = _values(cases, WITHOUT, value)
        difference = paired(values[OURS], values[MEAN_COST], "greater" if direction == "greater" else "less")
        found.append(
            settled(
                f"case_{name}",
                CHAPTER,
                f"Case study without goal: expected cost, against average cost, {text}",
                f"figure 3.2: {said}",
                f"{_told(values)}; less average cost {difference.told()}",
                [difference],
            )
        )
    return found


def _goal_cases(cases: Rows) -> list[Claim]:
    """Return the claims of the case study with a goal."""
    later = _values(cases, WITH, "goal_cost")
    found = []
    for objective, text, said in (
        (OPTIONS, "maximising options makes the cost at the goal higher", "very poor options at the goal"),
        (
            MEAN_COST,
            "minimising average cost leaves tempting grasps that are dear at the goal",
            "ours eliminates these",
        ),
    ):
        difference = paired(later[objective], later[OURS], "greater")
        found.append(
            settled(
                f"case_goal_{objective}",
                CHAPTER,
                f"Case study with goal: {text} (expected cost at the goal)",
                f"figure 3.3: {said}",
                f"{_told(later)}; less ours {difference.told()}; {difference.n} persons",
                [difference],
            )
        )
    return found


def metric_claims(rows: Rows) -> list[Claim]:
    """Return the claims on three objectives, several objects and goals."""
    costs = beside(rows, "objective", "cost", ("object", "goal"))
    found, pairs = anova(costs), tukey(costs, {(OPTIONS, MEAN_COST): "greater", (MEAN_COST, OURS): "greater"})
    claims = [
        settled(
            "metrics_anova",
            CHAPTER,
            "Objectives differ in expected total cost over objects and goals (main effect)",
            "F(2, 58) = 1031.07, p < 0.0001",
            f"{_told(costs)}; {told_f(found)}",
            [found],
        ),
        settled(
            "metrics_ours_over_mean",
            CHAPTER,
            "Expected cost outperforms minimum average cost (Tukey HSD)",
            "p < 0.001",
            pairs[MEAN_COST, OURS].told(),
            [pairs[MEAN_COST, OURS]],
        ),
        settled(
            "metrics_mean_over_options",
            CHAPTER,
            "Minimum average cost outperforms maximum feasibility (Tukey HSD)",
            "p < 0.0001",
            pairs[OPTIONS, MEAN_COST].told(),
            [pairs[OPTIONS, MEAN_COST]],
        ),
    ]
    for objective, name in BASELINES.items():
        times = CLAIMED[objective]
        more = against(costs[objective] - times * costs[OURS], 0.0, "greater", f"paired t-test of {times:g} times")
        claims.append(
            settled(
                f"metrics_times_{objective}",
                CHAPTER,
                f"Expected cost is at least {times:g} times lower than with {name}",
                f"{times:g} times lower",
                f"{mean_of(costs[objective]) / mean_of(costs[OURS]):.2f} times; cost less {times:g} times ours "
                f"{more.told()}",
                [more],
            )
        )
    return [*claims, *(_every(rows, factor) for factor in ("goal", "object"))]


def _every(rows: Rows, factor: str) -> Claim:
    """Return the claim that ours is best for every goal or for every object."""
    other, figure = ("object", "3.4") if factor == "goal" else ("goal", "3.5")
    comparisons, told = [], []
    for level in sorted({row[factor] for row in rows}):
        costs = beside(only(rows, **{factor: level}), "objective", "cost", (other,))
        comparisons += [paired(costs[baseline], costs[OURS], "greater") for baseline in BASELINES]
        told.append(f"{level}: " + " / ".join(f"{mean_of(costs[name]):.2f}" for name in (OURS, MEAN_COST, OPTIONS)))
    return settled(
        f"metrics_every_{factor}",
        CHAPTER,
        f"Expected cost is lower than with either baseline for every {factor}",
        f"figure {figure}: lowest for every {factor}",
        f"ours / average cost / feasibility: {'; '.join(told)}; significant in "
        f"{sum(each.significant for each in comparisons)} of {len(comparisons)} comparisons",
        comparisons,
    )


def region_claim(metrics: Rows, mismatch: Rows, name: str) -> Claim:
    """Return the claim that a mug is given so that it is taken by the top when it must stand upright at the goal."""
    plans = only(metrics, object=name, objective=OURS)
    plans += [row for row in mismatch if row["attitude"] == "any" and row["assumed"] == row["true"] == "MN"]
    upright, turned = (column(only(plans, kind=kind), "top_probability") for kind in ("upright", "upside_down"))
    found = independent(upright, turned, "greater")
    regions = {
        kind: ", ".join(sorted({row["region"].replace("_", " ") for row in only(plans, kind=kind)}))
        for kind in ("upright", "upside_down")
    }
    return settled(
        "goal_decides_region",
        CHAPTER,
        f"The {name} is offered so that it is taken by the top for goals where it stands upright, by the side for "
        "those where it is upside down",
        "figure 3.4: by the top, by the side",
        f"P(top) {mean_of(upright):.2f} against {mean_of(turned):.2f}, {found.told()}; likeliest regions for upright: "
        f"{regions['upright']}; upside down: {regions['upside_down']}",
        [found],
    )


def mismatch_claims(rows: Rows, attitude: str) -> list[Claim]:
    """Return the claims on whom the robot expects and who comes, for one way to offer the object."""
    costs = costs_by_person(only(rows, attitude=attitude))
    losses = {(assumed, true): values - costs[true, true] for (assumed, true), values in costs.items()}
    return [
        _right_is_best(costs, attitude, "MN", "3.6: significantly lower than any incorrect assumption"),
        _right_is_best(costs, attitude, "MP", "3.7: significantly lower than any other"),
        *(_better_than_myopic(costs, attitude, true) for true in ("GN", "GP")),
        _second_best(costs, attitude),
        _myopia_penalty(losses, attitude),
        _safe(losses, attitude),
        *_myopia_alone(costs, attitude),
        _noise_alone(costs, attitude),
    ]


def _claim(name: str, attitude: str, text: str, said: str, ours: str, comparisons: Sequence[Comparison]) -> Claim:
    """Return a claim of the mismatch study."""
    return settled(f"mismatch_{attitude}_{name}", CHAPTER, f"{ATTITUDES[attitude]}: {text}", said, ours, comparisons)


def _row(costs: dict[tuple[str, str], FloatArray], true: str) -> str:
    """Return what somebody pays for each assumption, in words."""
    return ", ".join(f"{assumed} {mean_of(costs[assumed, true]):.3f}" for assumed in PERSONS)


def _right_is_best(costs: dict[tuple[str, str], FloatArray], attitude: str, true: str, figure: str) -> Claim:
    """Return the claim that the right assumption costs less than all others."""
    others = [each for each in PERSONS if each != true]
    comparisons = [paired(costs[each, true], costs[true, true], "greater") for each in others]
    told = "; ".join(f"{each} {found.told()}" for each, found in zip(others, comparisons))
    return _claim(
        f"{true}_right",
        attitude,
        f"a person who is {true} pays least when the robot expects {true}",
        f"figure {figure}",
        f"assumed {_row(costs, true)}; more by {told}",
        comparisons,
    )


def _better_than_myopic(costs: dict[tuple[str, str], FloatArray], attitude: str, true: str) -> Claim:
    """Return the claim that a global person pays a little more when the robot expects MN."""
    found = paired(costs["MN", true], costs[true, true], "greater")
    return _claim(
        f"{true}_right",
        attitude,
        f"a person who is {true} pays less when the robot expects {true} than when it expects MN",
        "figure 3.7: significant, and very small",
        f"assumed {_row(costs, true)}; MN more by {found.told()}",
        [found],
    )


def _second_best(costs: dict[tuple[str, str], FloatArray], attitude: str) -> Claim:
    """Return the claim that MN is second best for a person who is MP."""
    comparisons = [paired(costs[other, "MP"], costs["MN", "MP"], "greater") for other in ("GN", "GP")]
    return _claim(
        "MP_second",
        attitude,
        "for a person who is MP, MN is better than GN and GP",
        "figure 3.7: MN second best",
        f"assumed {_row(costs, 'MP')}; GN, GP more than MN by {', '.join(each.told() for each in comparisons)}",
        comparisons,
    )


def _myopia_penalty(losses: dict[tuple[str, str], FloatArray], attitude: str) -> Claim:
    """Return the claim that to miss myopia costs more than to assume it wrongly."""
    comparisons = [paired(losses[other, "MN"], losses["MN", other], "greater") for other in ("GN", "GP")]
    told = "; ".join(
        f"{other} for MN {mean_of(losses[other, 'MN']):.3f}, MN for {other} {mean_of(losses['MN', other]):.3f}, "
        f"{found.told()}"
        for other, found in zip(("GN", "GP"), comparisons)
    )
    return _claim(
        "penalty",
        attitude,
        "expecting a global person who is MN costs more than expecting MN of a global person",
        "figure 3.7: large penalty against a small one",
        f"loss: {told}",
        comparisons,
    )


def _safe(losses: dict[tuple[str, str], FloatArray], attitude: str) -> Claim:
    """Return the claim that the worst loss with MN is less than with any other assumption."""
    worst = {assumed: np.max([losses[assumed, true] for true in PERSONS], axis=0) for assumed in PERSONS}
    comparisons = [paired(worst[other], worst["MN"], "greater") for other in PERSONS if other != "MN"]
    return _claim(
        "safe",
        attitude,
        "whoever comes, the worst loss is least when the robot expects MN",
        "figure 3.7: consistent costs for MN, others much more for at least one person",
        ", ".join(f"{each} {mean_of(worst[each]):.3f}" for each in PERSONS)
        + f"; others more than MN by {', '.join(each.told() for each in comparisons)}",
        comparisons,
    )


def pooled_costs(costs: dict[tuple[str, str], FloatArray], letter: int) -> dict[tuple[str, str], FloatArray]:
    """Return costs over goals (goals,) by one letter of (assumed, true), the mean over the other (figures 3.8, 3.9)."""
    found: dict[tuple[str, str], list[FloatArray]] = {}
    for (assumed, true), values in costs.items():
        found.setdefault((assumed[letter], true[letter]), []).append(values)
    return {key: np.mean(values, axis=0) for key, values in found.items()}


def _myopia_alone(costs: dict[tuple[str, str], FloatArray], attitude: str) -> list[Claim]:
    """Return the claims of figure 3.8."""
    pooled = pooled_costs(costs, 0)
    drop = paired(pooled["G", "M"], pooled["M", "M"], "greater")
    small = paired(pooled["G", "M"] - pooled["M", "M"], pooled["M", "G"] - pooled["G", "G"], "greater")
    loss = mean_of(pooled["M", "G"] - pooled["G", "G"])
    return [
        _claim(
            "myopic",
            attitude,
            "myopic people pay less when the robot expects myopia, noise apart",
            "figure 3.8: a large drop",
            f"{mean_of(pooled['M', 'M']):.3f} against {mean_of(pooled['G', 'M']):.3f}; {drop.told()}",
            [drop],
        ),
        _claim(
            "myopic_small_loss",
            attitude,
            "expecting myopia of global people loses less than that gains with myopic ones",
            "figure 3.8: only a small loss",
            f"loss {loss:.3f}, gain {drop.effect:.3f}; gain less loss {small.told()}",
            [small],
        ),
    ]


def _noise_alone(costs: dict[tuple[str, str], FloatArray], attitude: str) -> Claim:
    """Return the claim of figure 3.9, whose differences were not significant: that noise matters less than myopia."""
    pooled, myopia = pooled_costs(costs, 1), pooled_costs(costs, 0)
    gains = {each: pooled["NP".replace(each, ""), each] - pooled[each, each] for each in "NP"}
    both = [against(gains[each], 0.0, "greater", "paired t-test") for each in "NP"]
    matters = paired(myopia["G", "M"] - myopia["M", "M"], np.maximum(gains["N"], gains["P"]), "greater")
    told = f"gain of the right one: noisy {both[0].told()}, perfect {both[1].told()}"
    return _claim(
        "noise_matters_less",
        attitude,
        "to expect the right noise gains less than to expect myopia rightly",
        "figures 3.8 and 3.9: best, yet not significant, against a large drop",
        f"{told}; gain of myopia less the greater of these {matters.told()}",
        [matters],
    )
