"""The claims of section 3.5 on whom the robot should expect: what it costs when somebody else comes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.studies.chapter3_settings import PERSONS
from handover_ros.studies.chapter3_tables import costs_by_person
from handover_ros.studies.claims import Claim, settled
from handover_ros.studies.group_statistics import mean_of
from handover_ros.studies.statistics import Comparison, against, paired
from handover_ros.studies.tables import Rows, only

CHAPTER = 3
ATTITUDES = {"any": "Offered in any attitude", "upright": "Offered upright"}


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
