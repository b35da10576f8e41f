"""What ``config/studies/chapter3.yaml`` says: how people choose, what they are offered, and how many there are."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from handover_ros.planning.choice import ChoiceModel
from handover_ros.resources import config_file
from handover_ros.yaml_file import Schema, Vector3, read_yaml

Count = Annotated[int, Field(ge=2, le=1000)]  # of what tests are made on: one has no scatter
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Length = Annotated[float, Field(gt=0.0, le=5.0)]
Spread = Annotated[float, Field(ge=0.0, le=1.0)]
Attitude = Literal["any", "upright"]
PERSONS = ("MN", "MP", "GN", "GP")  # myopic or global, noisy or perfect


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    """Refuse bounds that cross."""
    if pair[0] > pair[1]:
        raise ValueError(f"the lower bound {pair[0]:g} must not be above the upper bound {pair[1]:g}")
    return pair


def _different(names: tuple[str, ...]) -> tuple[str, ...]:
    """Refuse a name that comes twice."""
    if len(set(names)) < len(names):
        raise ValueError("names one twice")
    return names


class MyopiaSettings(Schema):
    """gamma of eq. 3.5, of those who are called myopic (M) and of those who are called global (G)."""

    myopic: Share
    far_sighted: Share


class PoseSettings(Schema):
    """A pose in the torso frame: metres, radians."""

    xyz: Vector3
    rpy: Vector3


class GoalSettings(Schema):
    """Where goals lie [m], in the torso frame."""

    lower: Vector3
    upper: Vector3

    @model_validator(mode="after")
    def _in_order(self) -> GoalSettings:
        """Refuse bounds that cross."""
        if any(low > high for low, high in zip(self.lower, self.upper)):
            raise ValueError("goals: a lower bound is above the upper one")
        return self


class CaseSettings(Schema):
    """The case studies (figures 3.2 and 3.3)."""

    object: str
    people: Count
    goal: PoseSettings


class MetricsSettings(Schema):
    """The three objectives over objects and goals (figures 3.4 and 3.5)."""

    objects: Annotated[tuple[str, ...], Field(min_length=2), AfterValidator(_different)]
    goals: Count


class MismatchSettings(Schema):
    """Whom the robot expects and who comes (figures 3.6 to 3.9)."""

    object: str
    goals: Count
    attitudes: Annotated[tuple[Attitude, ...], Field(min_length=1), AfterValidator(_different)]


class StudyPeople(Schema):
    """Number of simulated subjects of each user study."""

    metrics: Count
    models: Count


class ShelfSettings(Schema):
    """A shelf, clear inside [m]."""

    depth: Length
    width: Length
    height: Length
    thickness: Length


class UserStudySettings(Schema):
    """The user studies (section 3.6); spreads are standard deviations."""

    object: str
    goals: Count
    people: StudyPeople
    neutral_spread: Spread
    weight_spread: Spread
    length_spread: Annotated[float, Field(ge=0.0, le=0.3)]
    aware_myopia: Annotated[tuple[Share, Share], AfterValidator(_rising)]
    table: Vector3
    shelf: ShelfSettings


class QuickSettings(Schema):
    """What ``--quick`` makes smaller."""

    case_people: Count
    metric_goals: Count
    mismatch_goals: Count
    user_goals: Count


class Chapter3Settings(Schema):
    """All of it."""

    rationality: Annotated[float, Field(gt=0.0, le=1e4)]
    myopia: MyopiaSettings
    regrasp: Annotated[float, Field(ge=1.0, le=100.0)]
    robot_reach: bool
    searches: Annotated[int, Field(ge=1, le=20)]
    moves_to_goal: bool
    scene: str
    shoulders: Annotated[float, Field(gt=0.5, le=2.5)]
    goals: GoalSettings
    case_study: CaseSettings
    metrics: MetricsSettings
    mismatch: MismatchSettings
    user_studies: UserStudySettings
    quick: QuickSettings

    def quickened(self) -> Chapter3Settings:
        """Return the settings of a quick run."""
        quick = self.quick
        return self.model_copy(
            update={
                "case_study": self.case_study.model_copy(update={"people": quick.case_people}),
                "metrics": self.metrics.model_copy(update={"goals": quick.metric_goals}),
                "mismatch": self.mismatch.model_copy(update={"goals": quick.mismatch_goals}),
                "user_studies": self.user_studies.model_copy(update={"goals": quick.user_goals}),
            }
        )

    def choice(self, name: str) -> ChoiceModel:
        """Return how a person called MN, MP, GN or GP chooses."""
        myopia = self.myopia.myopic if name[0] == "M" else self.myopia.far_sighted
        return ChoiceModel(name, self.rationality if name[1] == "N" else np.inf, myopia)


def load_chapter3_settings() -> Chapter3Settings:
    """Return the settings of the study.

    Raises:
        BadModelError: The file is wrong; the message names file and field.
    """
    return read_yaml(config_file("studies", "chapter3"), Chapter3Settings)
