"""What ``config/studies/beyond.yaml`` says."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from handover_ros.resources import config_file
from handover_ros.studies.chapter4_settings import Number, Particles, Strategy
from handover_ros.yaml_file import Schema, read_yaml

NEEDED = ("active_value", "active", "hybrid", "passive")


def _complete(names: tuple[str, ...]) -> tuple[str, ...]:
    """Refuse a list without the strategies that are compared, or with one twice."""
    if missing := [name for name in NEEDED if name not in names]:
        raise ValueError(f"must have {', '.join(NEEDED)}; lacks {', '.join(missing)}")
    if len(set(names)) < len(names):
        raise ValueError("names a strategy twice")
    return names


class QuickBeyondSettings(Schema):
    """What ``--quick`` makes smaller."""

    people: Number
    handovers: Number
    per_object: Number


class BeyondSettings(Schema):
    """All of it."""

    people: Number
    quick: QuickBeyondSettings
    particles: Particles
    rationality: Annotated[float, Field(gt=0.0, le=1e4)]
    handovers: Number
    per_object: Number
    asked: Annotated[tuple[str, ...], Field(min_length=1)]
    judged: Annotated[tuple[str, ...], Field(min_length=1)]
    strategies: Annotated[tuple[Strategy, ...], AfterValidator(_complete)]
    information_weight: Annotated[float, Field(ge=0.0, le=1.0)]
    missed: Annotated[float, Field(ge=1.0, le=100.0)]

    def quickened(self) -> BeyondSettings:
        """Return the settings of a quick run."""
        return self.model_copy(update=dict(self.quick))


def load_beyond_settings() -> BeyondSettings:
    """Return the settings of the study.

    Raises:
        BadModelError: The file is missing or wrong; the message names the field.
    """
    return read_yaml(config_file("studies", "beyond"), BeyondSettings)
