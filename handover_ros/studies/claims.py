"""Claims of the dissertation beside what the data say: a verdict is never written down, it follows from tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

from handover_ros.cell.report import finite
from handover_ros.studies.statistics import Comparison

Verdict = Literal["reproduced", "not reproduced", "needs people"]
NOT_MEASURED = "not measured: needs living subjects"


@dataclass(frozen=True)
class Claim:
    """One claim.

    Attributes:
        name: Its id.
        chapter: Of the dissertation.
        text: What is claimed.
        dissertation: What the dissertation found.
        ours: What was found here, with numbers.
        rule: When it counts as reproduced.
        comparisons: The tests of the rule.
        verdict: What follows.
    """

    name: str
    chapter: int
    text: str
    dissertation: str
    ours: str
    rule: str
    comparisons: tuple[Comparison, ...]
    verdict: Verdict

    def document(self) -> dict[str, object]:
        """Return it for JSON."""
        tests = [
            {key: finite(value) if isinstance(value, float) else value for key, value in asdict(each).items()}
            for each in self.comparisons
        ]
        return {
            "id": self.name,
            "chapter": self.chapter,
            "text": self.text,
            "dissertation": self.dissertation,
            "ours": self.ours,
            "verdict": self.verdict,
            "rule": self.rule,
            "tests": tests,
        }


def settled(
    name: str, chapter: int, text: str, dissertation: str, ours: str, comparisons: Sequence[Comparison]
) -> Claim:
    """Return a claim that is reproduced when every comparison is significant in its direction."""
    verdict: Verdict = "reproduced" if all(each.significant for each in comparisons) else "not reproduced"
    names = "; ".join(dict.fromkeys(each.test for each in comparisons))
    return Claim(name, chapter, text, dissertation, ours, f"p < 0.05 in each: {names}", tuple(comparisons), verdict)


def for_people(name: str, chapter: int, text: str, dissertation: str) -> Claim:
    """Return a claim that only living subjects can settle."""
    return Claim(name, chapter, text, dissertation, NOT_MEASURED, "needs living subjects", (), "needs people")
