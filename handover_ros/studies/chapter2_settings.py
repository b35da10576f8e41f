"""What ``config/studies/chapter2.yaml`` says: the simulated subjects, what they find comfortable, their markers."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from handover_ros.resources import config_file
from handover_ros.yaml_file import Schema, read_yaml

Count = Annotated[int, Field(ge=2, le=1000)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0, le=1000.0)]
Metres = Annotated[float, Field(ge=0.0, le=0.5)]
Radians = Annotated[float, Field(ge=0.0, le=1.5)]
Seconds = Annotated[float, Field(ge=0.2, le=10.0)]
USUAL = "usual"


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    """Refuse bounds that are not in order."""
    if pair[0] >= pair[1]:
        raise ValueError(f"the lower bound {pair[0]:g} must be below the upper bound {pair[1]:g}")
    return pair


def _has_usual(tastes: dict[str, TasteSettings]) -> dict[str, TasteSettings]:
    """Refuse tastes without the one that claims are about."""
    if next(iter(tastes), "") != USUAL:
        raise ValueError(f"must begin with {USUAL!r}")
    return tastes


class SubjectSettings(Schema):
    """How subjects differ; lengths [m], angles [rad]."""

    stature: Annotated[
        tuple[Annotated[float, Field(ge=1.3)], Annotated[float, Field(le=2.1)]], AfterValidator(_ordered)
    ]
    proportion: Annotated[float, Field(ge=0.0, le=0.3)]
    range: Annotated[tuple[Annotated[float, Field(ge=0.4)], Annotated[float, Field(le=1.2)]], AfterValidator(_ordered)]
    strap_shift: Radians
    left_handed: Share
    neutral: Radians
    placement: Annotated[float, Field(ge=0.0, le=0.03)]
    feet: Annotated[float, Field(gt=0.0, le=0.5)]


class TasteSettings(Schema):
    """Factors of the usual weights of trunk, shoulders and all joints from the elbow on."""

    trunk: Positive
    shoulder: Positive
    forearm: Positive


class TrialSettings(Schema):
    """How trials differ: standard deviations of the feet's place [m], of their heading and of the neutral [rad]."""

    position: Annotated[float, Field(ge=0.0, le=0.1)]
    heading: Annotated[float, Field(ge=0.0, le=0.3)]
    neutral: Radians


class HoldSettings(Schema):
    """Misses of a hand that cost the person 1, and those beyond which nothing is taken: [m] and [rad]."""

    costly_position: Annotated[float, Field(gt=0.0, le=0.1)]
    costly_angle: Annotated[float, Field(gt=0.0, le=1.0)]
    most_position: Annotated[float, Field(gt=0.0, le=0.2)]
    most_angle: Annotated[float, Field(gt=0.0, le=1.5)]


class MarkerSettings(Schema):
    """What motion capture sees: rate [Hz], errors of a coordinate [m], share missing, and times of a trial [s]."""

    rate: Annotated[float, Field(ge=20.0, le=500.0)]
    noise: Annotated[float, Field(ge=0.0, le=0.02)]
    skin: Annotated[float, Field(ge=0.0, le=0.03)]
    skin_time: Seconds
    missing: Annotated[float, Field(ge=0.0, le=0.3)]
    stand: Seconds
    reach: Seconds
    stay: Seconds


class QuickSettings(Schema):
    """What ``--quick`` makes smaller."""

    subjects: Count
    repetitions: Annotated[int, Field(ge=1, le=1000)]


class Chapter2Settings(Schema):
    """All of it."""

    subjects: Count
    repetitions: Annotated[int, Field(ge=1, le=1000)]
    quick: QuickSettings
    scene: str
    object: str
    like: str
    strap: str
    subject: SubjectSettings
    tastes: Annotated[dict[str, TasteSettings], AfterValidator(_has_usual)]
    trial: TrialSettings
    hold: HoldSettings
    markers: MarkerSettings
    calibration_frames: Annotated[int, Field(ge=60, le=20000)]
    workspace_voxel: Annotated[float, Field(ge=0.01, le=0.1)]
    alike: Annotated[float, Field(gt=0.0, le=90.0)]

    def quickened(self) -> Chapter2Settings:
        """Return the settings of a quick run."""
        return self.model_copy(update=dict(self.quick))


def load_chapter2_settings() -> Chapter2Settings:
    """Return the settings of the study.

    Raises:
        BadModelError: The file is wrong; the message names file and field.
    """
    return read_yaml(config_file("studies", "chapter2"), Chapter2Settings)
