"""The claims of section 3.6: two user studies, with simulated subjects where measures are objective."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.studies.chapter3_tables import beside
from handover_ros.studies.chapter3_users import AWARE, MEASURES, METRICS, MODELS, PARTS, PROGRAMS, UNAWARE
from handover_ros.studies.claims import Claim, for_people, settled
from handover_ros.studies.group_statistics import anova, cronbach, mean_of, more_than_chance, told_f, tukey
from handover_ros.studies.statistics import Comparison, Direction, against, alike
from handover_ros.studies.tables import Rows, column, only

CHAPTER = 3
FEASIBLE = ("OM1", "OM2")  # measures that look only at grasps that were feasible at the handover
ANY = ("OM3", "OM4")
STUDIES = {METRICS: "User study of objectives", MODELS: "User study of models, shelf"}
PART = {UNAWARE: "goal not known", AWARE: "goal known"}
ALIKE = 0.1  # share of the mean cost within which two programs are the same
BLOCKS = {"person": "subjects", "goal": "goals"}
TABLES = {(METRICS, UNAWARE): "3.3", (METRICS, AWARE): "3.4", (MODELS, UNAWARE): "3.6", (MODELS, AWARE): "3.7"}
# Of the dissertation's tables: the program that is claimed to be better, and the other.
SAID = {
    "3.3": {"OM1": (6.02, 12.43), "OM2": (6.30, 12.41), "OM3": (11.26, 12.18), "OM4": (11.45, 12.28)},
    "3.4": {"OM1": (5.37, 11.42), "OM2": (5.61, 11.52), "OM3": (11.02, 11.72), "OM4": (11.23, 11.84)},
    "3.6": {"OM1": (6.81, 10.10), "OM2": (7.20, 10.37), "OM3": (6.82, 10.12), "OM4": (7.86, 10.88)},
    "3.7": {"OM1": (6.01, 5.93), "OM2": (6.52, 6.19), "OM3": (6.03, 5.95), "OM4": (7.37, 7.61)},
}
ALPHAS = {UNAWARE: "0.9036", AWARE: "0.8830"}
ANOVAS = {UNAWARE: "F(1, 179) = 377.83, p < 0.0001", AWARE: "significant, analogous to part 1"}
GOALS = {UNAWARE: "significantly lower for 7 of 10 goals, all p < 0.03", AWARE: "significantly lower for 7 of 10 goals"}
# What only people can tell, tables 3.5 and 3.8: maximum feasibility and expected cost; GP and MN.
ASKED = {
    "prefer": ("'I prefer Program --'", "2.0 and 6.2, t(8) = 9.73, p < 0.0001", "3.7 and 5.0"),
    "helpful": ("'The robot was helpful'", "3.4 and 6.4, t(8) = 6.80, p < 0.0001", "4.7 and 5.7"),
    "trust": ("'I trust the robot'", "3.7 and 6.1, t(8) = 4.4, p < 0.01", "4.7 and 5.0"),
    "understood": ("'The robot understood my goal'", "2.8 and 6.4, t(8) = 5.33, p < 0.001", "4.5 and 5.5"),
    "easy": ("'It was physically easy to do the task'", "2.8 and 6.2, t(8) = 6.50, p < 0.001", "4.4 and 5.5"),
    "easier": (
        "'The robot handed me objects in a way that made the task easier'",
        "2.0 and 6.3, t(8) = 9.19, p < 0.0001",
        "4.1 and 5.5",
    ),
    "choice": ("forced choice of a program", "0 % and 100 %", "30 % and 70 %"),
}


def user_claims(rows: Rows) -> list[Claim]:
    """Return all claims of both user studies; ``rows`` of table ``users``."""
    found = []
    for part in PARTS:
        found += _main_effect(rows, part)
        found += [_measure(rows, METRICS, part, measure) for measure in MEASURES]
    found += [_marked(rows), _aware_is_cheaper(rows)]
    found += [_measure(rows, MODELS, UNAWARE, measure) for measure in MEASURES]
    found += [_unchanged(rows, measure) for measure in MEASURES]
    found += [*(_infeasible(rows, part) for part in PARTS), _smaller_effect(rows)]
    for name, (text, first, second) in ASKED.items():
        found.append(
            for_people(f"users_{METRICS}_{name}", CHAPTER, f"Table 3.5, {text}", f"feasibility, ours: {first}")
        )
        found.append(for_people(f"users_{MODELS}_{name}", CHAPTER, f"Table 3.8, {text}", f"GP, MN: {second}"))
    return found


def by_program(rows: Rows, study: str, part: str, measure: str, block: str = "person") -> dict[str, FloatArray]:
    """Return a measure by program over subjects or goals (n,), the mean of each one's trials."""
    return beside(only(rows, study=study, part=part), "program", measure, (block,))


def aggregated(rows: Rows) -> Rows:
    """Return the rows with the mean of OM1 to OM4 as ``aggregate``."""
    return [
        {**row, "aggregate": None if row[MEASURES[0]] is None else float(np.mean([row[each] for each in MEASURES]))}
        for row in rows
    ]


def gain(rows: Rows, study: str, part: str, measure: str, block: str) -> FloatArray:
    """Return by how much a measure is lower with the program that is claimed to be better, by subject or goal (n,)."""
    better, other = PROGRAMS[study]
    values = by_program(rows, study, part, measure, block)
    return values[other] - values[better]


def _positive(differences: Mapping[str, FloatArray]) -> list[Comparison]:
    """Return whether differences are greater than 0, over subjects and over goals: simulated subjects are much alike.

    What all of them do at one goal is certain of these subjects, but says little about goals.
    """
    return [
        against(values, 0.0, "greater", f"paired t-test over {BLOCKS[block]}") for block, values in differences.items()
    ]


def _told(found: Sequence[Comparison]) -> str:
    """Return both tests in words."""
    return "; ".join(f"over {name} {each.told()}" for name, each in zip(BLOCKS.values(), found))


def _means(values: dict[str, FloatArray]) -> str:
    """Return the means of programs in words."""
    return ", ".join(f"{program.replace('_', ' ')} {mean_of(each):.2f}" for program, each in values.items())


def _main_effect(rows: Rows, part: str) -> list[Claim]:
    """Return the claims of the analysis of variance of part 1 or 2 of the study of objectives, and its reliability."""
    kept = aggregated(only(rows, study=METRICS, part=part))
    better, other = PROGRAMS[METRICS]
    values = by_program(kept, METRICS, part, "aggregate")
    effect = _positive({block: gain(kept, METRICS, part, "aggregate", block) for block in BLOCKS})
    trials = beside(kept, "program", "aggregate", ("person", "goal"))
    factor = anova(trials)
    goals = sorted({row["goal"] for row in kept})
    gains = {str(goal): gain(only(kept, goal=goal), METRICS, part, "aggregate", "person") for goal in goals}
    interaction = anova(gains, "one-way ANOVA of differences")
    cells = {
        f"{program} {goal}": column(only(kept, goal=goal, program=program), "aggregate")
        for goal in goals
        for program in (better, other)
    }
    wanted: dict[tuple[str, str], Direction] = {(f"{other} {goal}", f"{better} {goal}"): "greater" for goal in goals}
    lower = sum(each.significant for each in tukey(cells, wanted).values())
    share = more_than_chance(lower, len(goals), "goals that are lower by Tukey HSD")
    items = np.array([[np.nan if row[each] is None else row[each] for each in MEASURES] for row in kept])
    alpha, start = cronbach(items), f"{STUDIES[METRICS]}, {PART[part]}"
    return [
        settled(
            f"users_{METRICS}_{part}_alpha",
            CHAPTER,
            f"{start}: OM1 to OM4 measure one thing (Cronbach's alpha)",
            f"alpha {ALPHAS[part]}",
            f"alpha {alpha.effect:.4f} [{alpha.low:.3f}, {alpha.high:.3f}] of {alpha.n} trials",
            [alpha],
        ),
        settled(
            f"users_{METRICS}_{part}_main",
            CHAPTER,
            f"{start}: expected cost lowers the cost at the goal (aggregate, main effect)",
            ANOVAS[part],
            f"{_means(values)}; {_told(effect)}; {told_f(factor)}",
            effect,
        ),
        settled(
            f"users_{METRICS}_{part}_interaction",
            CHAPTER,
            f"{start}: the benefit depends on the goal (interaction)",
            "significant interaction",
            told_f(interaction),
            [interaction],
        ),
        settled(
            f"users_{METRICS}_{part}_goals",
            CHAPTER,
            f"{start}: the cost at the goal is lower for more goals than by chance (Tukey HSD of all pairs)",
            GOALS[part],
            f"significantly lower for {lower} of {len(goals)} goals",
            [share],
        ),
    ]


def _measure(rows: Rows, study: str, part: str, measure: str) -> Claim:
    """Return the claim of one cell of tables 3.3, 3.4 and 3.6."""
    values, table = by_program(rows, study, part, measure), TABLES[study, part]
    better, other = PROGRAMS[study]
    found = _positive({block: gain(rows, study, part, measure, block) for block in BLOCKS})
    said = SAID[table][measure]
    return settled(
        f"users_{study}_{part}_{measure}",
        CHAPTER,
        f"{STUDIES[study]}, {PART[part]}: {measure} is lower with {better.replace('_', ' ')} than with "
        f"{other.replace('_', ' ')}",
        f"table {table}: {said[0]:.2f} against {said[1]:.2f}",
        f"{_means(values)}; {_told(found)}",
        found,
    )


def _marked(rows: Rows) -> Claim:
    """Return the claim that the gain is greater by the measures of grasps that were feasible at the handover."""

    def mean_gain(measures: Sequence[str], block: str) -> FloatArray:
        """Return the mean gain by some measures (n,)."""
        return np.asarray(np.mean([gain(rows, METRICS, UNAWARE, each, block) for each in measures], axis=0))

    found = _positive({block: mean_gain(FEASIBLE, block) - mean_gain(ANY, block) for block in BLOCKS})
    return settled(
        f"users_{METRICS}_marked",
        CHAPTER,
        f"{STUDIES[METRICS]}, {PART[UNAWARE]}: the difference is greater by OM1 and OM2 than by OM3 and OM4",
        "table 3.3: particularly marked for the first two",
        f"{mean_of(mean_gain(FEASIBLE, 'goal')):.3f} against {mean_of(mean_gain(ANY, 'goal')):.3f}; {_told(found)}",
        found,
    )


def _aware_is_cheaper(rows: Rows) -> Claim:
    """Return the claim that costs drop a little when people know the goal."""
    kept = aggregated(only(rows, study=METRICS))
    values = {block: beside(kept, "part", "aggregate", (block,)) for block in BLOCKS}
    found = _positive({block: each[UNAWARE] - each[AWARE] for block, each in values.items()})
    return settled(
        f"users_{METRICS}_aware",
        CHAPTER,
        f"{STUDIES[METRICS]}: costs at the goal are a little lower when people know the goal (aggregate)",
        "tables 3.3 and 3.4: dropped slightly across the board",
        f"unknown {mean_of(values['goal'][UNAWARE]):.3f}, known {mean_of(values['goal'][AWARE]):.3f}; {_told(found)}",
        found,
    )


def _unchanged(rows: Rows, measure: str) -> Claim:
    """Return the claim on a cell of table 3.7, by tests of equivalence: with a known goal MN and GP are alike."""
    values = by_program(rows, MODELS, AWARE, measure)
    margin = ALIKE * mean_of(values["GP"])
    found = []
    for block, name in BLOCKS.items():
        each = by_program(rows, MODELS, AWARE, measure, block)
        found += alike(each["GP"], each["MN"], margin, f"over {name}")
    said = SAID["3.7"][measure]
    return settled(
        f"users_{MODELS}_{AWARE}_{measure}",
        CHAPTER,
        f"{STUDIES[MODELS]}, {PART[AWARE]}: {measure} is the same with MN and GP within {100.0 * ALIKE:.0f} %",
        f"table 3.7: {said[0]:.2f} against {said[1]:.2f}, essentially unchanged",
        f"{_means(values)}; equivalence within {margin:.2f}: largest p {max(each.p for each in found):.3f}",
        found,
    )


def infeasible_counts(rows: Rows, part: str) -> dict[str, FloatArray]:
    """Return OM5 by program: how many of each subject's grasps cannot be placed in the shelf (n,)."""
    kept = only(rows, study=MODELS, part=part)
    found = {}
    people = sorted({row["person"] for row in kept})
    for program in PROGRAMS[MODELS]:
        own = only(kept, program=program)
        found[program] = np.array([np.nansum(column(only(own, person=each), "OM5")) for each in people])
    return found


def _infeasible(rows: Rows, part: str) -> Claim:
    """Return the claim of figure 3.16 for one part."""
    found = _positive({block: gain(rows, MODELS, part, "OM5", block) for block in BLOCKS})
    return settled(
        f"users_{MODELS}_{part}_OM5",
        CHAPTER,
        f"{STUDIES[MODELS]}, {PART[part]}: fewer grasps that are infeasible at the goal with MN than with GP (OM5)",
        "figure 3.16: drops significantly" + (", though the effect is much smaller" if part == AWARE else ""),
        f"per subject {_means(infeasible_counts(rows, part))}; share of trials {_told(found)}",
        found,
    )


def _smaller_effect(rows: Rows) -> Claim:
    """Return the claim that the effect on OM5 is smaller when the goal is known."""
    gains = {(part, block): gain(rows, MODELS, part, "OM5", block) for part in PARTS for block in BLOCKS}
    found = _positive({block: gains[UNAWARE, block] - gains[AWARE, block] for block in BLOCKS})
    unknown, known = (mean_of(gains[part, "goal"]) for part in PARTS)
    return settled(
        f"users_{MODELS}_OM5_smaller",
        CHAPTER,
        f"{STUDIES[MODELS]}: MN saves fewer infeasible grasps when the goal is known (OM5)",
        "figure 3.16: effect much smaller",
        f"saved share of trials: unknown {unknown:.3f}, known {known:.3f}; {_told(found)}",
        found,
    )
