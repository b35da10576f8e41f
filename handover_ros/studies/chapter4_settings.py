"""What ``config/studies/chapter4.yaml`` says: the simulated persons, their menus, and how many."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from handover_ros.arm.model import Side
from handover_ros.resources import config_file
from handover_ros.yaml_file import Schema, Vector3, read_yaml

Number = Annotated[int, Field(ge=1, le=1000)]
Angle = Annotated[float, Field(ge=-np.pi, le=np.pi)]
Weight = Annotated[float, Field(gt=0.0, le=1000.0)]
Particles = Annotated[int, Field(ge=50, le=100_000)]
Strategy = Literal["active", "active_value", "active_grid", "active_expected", "passive", "random", "hybrid"]
COMPARED = ("active", "passive", "random")


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    """Refuse bounds that are not in order."""
    if pair[0] >= pair[1]:
        raise ValueError(f"the lower bound {pair[0]:g} must be below the upper bound {pair[1]:g}")
    return pair


def _complete(names: tuple[str, ...]) -> tuple[str, ...]:
    """Refuse a list without the strategies that the dissertation compares, or with one twice."""
    if missing := [name for name in COMPARED if name not in names]:
        raise ValueError(f"must have {', '.join(COMPARED)}; lacks {', '.join(missing)}")
    if len(set(names)) < len(names):
        raise ValueError("names a strategy twice")
    return names


class PlanarSettings(Schema):
    """The planar arm (4.5): what is known while the other is learned, and bounds of the weights [1/rad2]."""

    queries: Number
    test_objects: Number
    known_neutral: tuple[Angle, Angle]
    known_weights: tuple[Weight, Weight]
    weight_bounds: Annotated[tuple[Weight, Weight], AfterValidator(_ordered)]


class ArtificialSettings(Schema):
    """The two artificial feasible sets (figures 4.3 and 4.4), all in [rad]."""

    queries: Number
    apart: Annotated[float, Field(gt=0.0, le=np.pi)]
    length: Annotated[float, Field(gt=0.0, le=np.pi)]
    bounds: Annotated[tuple[Angle, Angle], AfterValidator(_ordered)]


class GallerySettings(Schema):
    """The galleries of planar objects (figures 4.5 and 4.6)."""

    objects: Annotated[int, Field(ge=2, le=12)]
    looked_at: Annotated[int, Field(ge=10, le=5000)]


class ArmSettings(Schema):
    """The arm of seven joints and real objects (4.6); lengths [m], angles [rad].

    ``grasps``: the grasp regions of each of two objects that the person uses; ``every_grasp``: whether an offer is one
    only if the person can use all of them.
    """

    name: str
    side: Side
    robot: str
    grasps: Annotated[dict[str, tuple[str, ...]], Field(min_length=2, max_length=2)]
    every_grasp: bool
    queries: Number
    test_poses: Number
    least: Vector3
    most: Vector3
    tilt: Annotated[float, Field(ge=0.0, le=np.pi)]
    configurations: Annotated[int, Field(ge=10, le=5000)]
    least_configurations: Number


class UserStudySettings(Schema):
    """The user study's menus and tests (4.7)."""

    queries: Number
    poses: Number
    test_poses: Number


class QuickSettings(Schema):
    """What ``--quick`` makes smaller."""

    people: Number
    particles: Particles


class Chapter4Settings(Schema):
    """All of it; ``rationality`` and costs as in eq. 4.3."""

    people: Number
    particles: Particles
    quick: QuickSettings
    rationality: Annotated[float, Field(gt=0.0, le=1e4)]
    information_weight: Annotated[float, Field(ge=0.0, le=1.0)]
    strategies: Annotated[tuple[Strategy, ...], AfterValidator(_complete)]
    menu: Annotated[int, Field(ge=2, le=100)]
    planar: PlanarSettings
    artificial: ArtificialSettings
    gallery: GallerySettings
    arm: ArmSettings
    user_study: UserStudySettings

    def quickened(self) -> Chapter4Settings:
        """Return the settings of a quick run."""
        return self.model_copy(update=dict(self.quick))


def load_chapter4_settings() -> Chapter4Settings:
    """Return the settings of the study.

    Raises:
        BadModelError: The file is wrong; the message names file and field.
    """
    return read_yaml(config_file("studies", "chapter4"), Chapter4Settings)
