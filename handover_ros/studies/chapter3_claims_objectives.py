"""The claims of section 3.5 on the three objectives: case studies, objects and goals."""

from __future__ import annotations

from handover_ros.geometry import FloatArray
from handover_ros.studies.chapter3_cases import WITH, WITHOUT
from handover_ros.studies.chapter3_tables import beside
from handover_ros.studies.claims import Claim, settled
from handover_ros.studies.group_statistics import anova, mean_of, told_f, tukey
from handover_ros.studies.statistics import against, independent, paired
from handover_ros.studies.tables import Rows, column, only

CHAPTER = 3
OURS, MEAN_COST, OPTIONS = "expected_cost", "minimum_mean", "maximum_feasibility"
BASELINES = {OPTIONS: "maximum feasibility", MEAN_COST: "minimum average cost"}
CLAIMED = {OPTIONS: 3.0, MEAN_COST: 2.0}  # times the expected cost of ours


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
        told.append(
            f"{level + 1 if factor == 'goal' else level}: "
            + " / ".join(f"{mean_of(costs[name]):.2f}" for name in (OURS, MEAN_COST, OPTIONS))
        )
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
