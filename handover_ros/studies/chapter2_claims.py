"""The claims of chapter 2, each settled by a test of what the simulated subjects did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.studies.chapter2_settings import USUAL
from handover_ros.studies.chapter2_subjects import CONDITIONS
from handover_ros.studies.chapter2_trials import SCHEMES
from handover_ros.studies.claims import Claim, for_people, settled
from handover_ros.studies.statistics import Comparison, against, alike, correlated, paired, pooled
from handover_ros.studies.tables import Rows, column, only

CHAPTER = 2
MEAN_ERROR, LEAST_ERROR, GREATEST_ERROR = 14.9, 2.9, 48.6  # [mm], of section 2.3
GENERIC = ("constant", "relative")
ROTATION = "rotation_deg"
FIGURE = "figure 2.8"


def claims(tables: Mapping[str, Rows], tastes: Sequence[str], margin: float, generic_stature: float) -> list[Claim]:
    """Return all claims of the chapter.

    Args:
        tables: ``reprojection``, ``workspaces`` and ``trials``, as the units found them.
        tastes: Names of the persons' costs, the usual one first.
        margin: Torso rotations that differ by less are alike [deg].
        generic_stature: Of the person whom a generic model is made for [m].
    """
    rows = only(tables["trials"], taste=USUAL)
    found = [_reprojection(tables["reprojection"]), *_workspaces(tables["workspaces"]), *_free(rows, margin)]
    found += [_strapped(rows, scheme) for scheme in GENERIC]
    found += [_worse(rows, scheme) for scheme in GENERIC]
    found += [_neutral(rows, margin), _expected(rows), _morphology(rows, tables["reprojection"], generic_stature)]
    found += [_sensitivity(tables["trials"], taste) for taste in tastes if taste != USUAL]
    return found + [
        for_people(
            "back_injury",
            CHAPTER,
            "Trunk rotation at the handover correlates with lower back injury (section 2.1)",
            "taken from Marras et al., reference 26",
        ),
        for_people(
            "own_motion",
            CHAPTER,
            "Rigid twists capture how people really move: joints, skin and suit",
            f"mean of the markers' median errors {MEAN_ERROR} mm on four people",
        ),
    ]


def values(rows: Rows, condition: str, scheme: str) -> FloatArray:
    """Return the measured torso rotation [deg] of all trials (n,); NaN: there was no handover."""
    return column(only(rows, condition=condition, scheme=scheme), ROTATION)


def by_subject(rows: Rows, condition: str, scheme: str) -> FloatArray:
    """Return each subject's mean torso rotation [deg] (subjects,); NaN: no handover in any trial."""
    means = []
    for number in sorted({row["subject"] for row in rows}):
        own = values(only(rows, subject=number), condition, scheme)
        own = own[np.isfinite(own)]
        means.append(float(own.mean()) if len(own) else np.nan)
    return np.array(means)


def _means(rows: Rows, condition: str) -> str:
    """Return the mean rotations of all schemes in words."""
    told = ", ".join(f"{scheme} {np.nanmean(values(rows, condition, scheme)):.1f}" for scheme in SCHEMES)
    gaps = []
    for scheme in SCHEMES:
        own = only(rows, condition=condition, scheme=scheme)
        missing, short = sum(row[ROTATION] is None for row in own), sum(row["taken"] is False for row in own)
        gaps += [f"{missing} of {len(own)} {scheme} not planned"] if missing else []
        gaps += [f"{short} of {len(own)} {scheme} not quite reached"] if short else []
    return "; ".join([f"{told} deg", *gaps])


def _reprojection(rows: Rows) -> Claim:
    """Return the claim that the fitted skeleton explains the calibration motions."""
    arms = only(rows, arm=True)
    pairs = sorted({(row["subject"], row["condition"]) for row in arms})
    means = [column(only(arms, subject=number, condition=condition), "median_mm").mean() for number, condition in pairs]
    test, medians = (
        against(means, MEAN_ERROR, "less", "t-test against the dissertation's mean"),
        column(arms, "median_mm"),
    )
    return settled(
        "reprojection",
        CHAPTER,
        "The fitted skeleton explains the arm markers in the calibration motions, better than in the dissertation",
        f"medians of the 16 arm markers {LEAST_ERROR} to {GREATEST_ERROR} mm, mean {MEAN_ERROR} mm",
        f"medians {medians.min():.1f} to {medians.max():.1f} mm, mean {medians.mean():.1f} mm over {len(pairs)} "
        f"calibrations of simulated markers; {test.told(' mm')}",
        [test],
    )


def _workspaces(rows: Rows) -> list[Claim]:
    """Return the claims of figure 2.7."""
    shared = {condition: column(only(rows, condition=condition), "shared") for condition in CONDITIONS}
    overlap = paired(shared["strapped"], shared["free"], "less")
    free = only(rows, condition="free")
    own, true, other = (column(free, f"{name}rear_litres") for name in ("", "true_", "other_"))
    apart = paired(np.abs(own - other), np.abs(own - true), "greater")
    return [
        settled(
            "workspace_overlap",
            CHAPTER,
            "Workspaces of restricted arms of two subjects overlap less than those of free arms",
            "figure 2.7: only a small area of overlap",
            f"shared part of two subjects' union: strapped {shared['strapped'].mean():.2f} (least "
            f"{shared['strapped'].min():.2f}), free {shared['free'].mean():.2f}; difference {overlap.told()}",
            [overlap],
        ),
        settled(
            "workspace_rear",
            CHAPTER,
            "Free arms too differ: the part of the workspace behind the body is larger for one subject than for "
            "another by more than the error of calibration",
            "figure 2.7: significantly larger for Subject 2 than for Subject 1",
            f"two subjects differ by {np.abs(own - other).mean():.0f} of {own.mean():.0f} litres, calibration is off "
            f"by {np.abs(own - true).mean():.0f}; {apart.told(' litres')}",
            [apart],
        ),
    ]


def _free(rows: Rows, margin: float) -> list[Claim]:
    """Return the claim that with free arms the schemes do not differ: by the dissertation's test, and as equivalence.

    That a test finds no difference proves none, and many trials find the smallest one; hence the second claim.
    """
    own, within = [], []
    told: dict[str, list[str]] = {"own": [], "within": []}
    for first, second in combinations(SCHEMES, 2):
        own.append(pooled(values(rows, "free", first), values(rows, "free", second)))
        means = by_subject(rows, "free", first), by_subject(rows, "free", second)
        within += alike(*means, margin, "deg")
        told["own"].append(f"{first} less {second} {own[-1].told(' deg')}")
        told["within"].append(f"{first} less {second} {np.nanmean(means[0] - means[1]):+.2f} deg")
    text, said = (
        "With free arms the three schemes give the same torso rotation",
        f"no significant difference ({FIGURE} top)",
    )
    return [
        Claim(
            "free_no_difference",
            CHAPTER,
            f"{text}: the dissertation's own test finds no difference",
            said,
            f"{_means(rows, 'free')}; pooled trials: {', '.join(told['own'])}",
            "p >= 0.05 in each: pooled t-test, two-sided",
            tuple(own),
            "not reproduced" if any(test.significant for test in own) else "reproduced",
        ),
        settled(
            "free_alike",
            CHAPTER,
            f"{text}: equal within {margin:g} deg",
            said,
            f"means of subjects: {', '.join(told['within'])}; equivalence p = {max(test.p for test in within):.3f}",
            within,
        ),
    ]


def conclusion(rows: Rows, scheme: str) -> list[Comparison]:
    """Return the tests that restricted arms turn the torso less with the personal scheme: by subject, and pooled."""
    return [
        paired(by_subject(rows, "strapped", "personal"), by_subject(rows, "strapped", scheme), "less"),
        pooled(values(rows, "strapped", "personal"), values(rows, "strapped", scheme), "less"),
    ]


def each_subject(rows: Rows, condition: str, scheme: str) -> tuple[int, int]:
    """Return for how many subjects the personal scheme turns the torso less (paired by repetition), and of how many."""
    numbers = sorted({row["subject"] for row in rows})
    less = 0
    for number in numbers:
        own = only(rows, subject=number, condition=condition)
        first, second = (
            sorted(only(own, scheme=name), key=lambda row: row["repetition"]) for name in ("personal", scheme)
        )
        less += paired(column(first, ROTATION), column(second, ROTATION), "less").significant
    return less, len(numbers)


def _strapped(rows: Rows, scheme: str) -> Claim:
    """Return the claim H0 of the dissertation for one of the other schemes."""
    comparisons = conclusion(rows, scheme)
    less, every = each_subject(rows, "strapped", scheme)
    return settled(
        f"strapped_{scheme}",
        CHAPTER,
        f"With the dominant arm restricted, {scheme} turns the torso more than personal",
        f"significant, pairwise t-test, p < 0.05 ({FIGURE} bottom)",
        f"{_means(rows, 'strapped')}; personal less {scheme}: by subject {comparisons[0].told(' deg')}, pooled trials "
        f"{comparisons[1].told(' deg')}; alone significant in {less} of {every} subjects",
        comparisons,
    )


def _worse(rows: Rows, scheme: str) -> Claim:
    """Return the claim that generic schemes become worse when an arm is restricted."""
    test = paired(by_subject(rows, "strapped", scheme), by_subject(rows, "free", scheme), "greater")
    return settled(
        f"compensation_{scheme}",
        CHAPTER,
        f"A restricted arm necessitates compensatory motion of the torso with {scheme}",
        "section 2.4: performance of generic methods degrades",
        f"strapped less free {test.told(' deg')}",
        [test],
    )


def _neutral(rows: Rows, margin: float) -> Claim:
    """Return the claim that the personal scheme lets the torso stay neutral."""
    strapped, free = by_subject(rows, "strapped", "personal"), by_subject(rows, "free", "relative")
    name = f"paired t-test against {margin:g} deg"
    test = against(strapped - free, margin, "less", name)
    return settled(
        "personal_neutral",
        CHAPTER,
        "With personal, subjects with a restricted arm keep a neutral torso: turned no more than with free arms and "
        f"relative (by {margin:g} deg)",
        "section 2.4: allowed test subjects to maintain a neutral body posture",
        f"personal, strapped {np.nanmean(strapped):.1f} deg; relative, free {np.nanmean(free):.1f} deg; difference "
        f"less margin {test.told(' deg')}",
        [test],
    )


def _expected(rows: Rows) -> Claim:
    """Return the expectation that a constant place turns the torso more even of free arms."""
    tests = [
        paired(by_subject(rows, "free", "constant"), by_subject(rows, "free", other), "greater")
        for other in SCHEMES[1:]
    ]
    told = ", ".join(f"less {other} {test.told(' deg')}" for other, test in zip(SCHEMES[1:], tests))
    return settled(
        "constant_expected",
        CHAPTER,
        "Expected beforehand (section 2.1): constant turns the torso more than relative and personal, free arms too",
        "expected; not found with free arms",
        f"constant {told}",
        tests,
    )


def _morphology(rows: Rows, bodies: Rows, generic_stature: float) -> Claim:
    """Return the expectation that a constant place suits those least whose body is least like the generic one."""
    numbers = sorted({row["subject"] for row in rows})
    unlike = [abs(only(bodies, subject=number)[0]["stature"] - generic_stature) for number in numbers]
    excess = by_subject(rows, "free", "constant") - by_subject(rows, "free", "personal")
    kept = np.isfinite(excess)
    test = correlated(np.array(unlike)[kept], excess[kept])
    return settled(
        "constant_morphology",
        CHAPTER,
        "Expected beforehand (section 2.1): constant turns the torso particularly of subjects unlike the generic model",
        "expected; not reported",
        f"rank correlation of difference in stature with constant less personal, free arms: {test.told()}",
        [test],
    )


def _sensitivity(rows: Rows, taste: str) -> Claim:
    """Return whether the conclusion holds for persons with another cost."""
    own = only(rows, taste=taste)
    comparisons = [test for scheme in GENERIC for test in conclusion(own, scheme)]
    return settled(
        f"cost_{taste}",
        CHAPTER,
        f"The conclusion for restricted arms also holds if persons choose postures by another cost: {taste}",
        "not examined",
        f"{_means(own, 'strapped')}; personal less constant {comparisons[0].told(' deg')}, less relative "
        f"{comparisons[2].told(' deg')}, by subject",
        comparisons,
    )
