"""What a calibration found out, for people: errors, certainty, and what to do better."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MarkerError:
    """How well the skeleton explains one marker.

    Attributes:
        name: The marker.
        segment: What carries it.
        fitted_rms: Root mean square distance [m] in the frames of the fit; NaN: not seen there.
        heldout_mean: Mean distance [m] in frames left out of the fit; NaN: not seen there.
    """

    name: str
    segment: str
    fitted_rms: float
    heldout_mean: float


@dataclass(frozen=True)
class JointQuality:
    """What is known of one displacement.

    Attributes:
        name: Its joint.
        displacement: Its name.
        lower: Lower limit [rad] or [m].
        upper: Upper limit.
        moved: Range seen [rad] or [m].
        axis_error: Standard error of the axis' direction [rad]; 0 for a ball joint, which has none of its own.
        point_error: Standard error [m] of the joint's centre, or of its axis' place.
    """

    name: str
    displacement: str
    lower: float
    upper: float
    moved: float
    axis_error: float
    point_error: float


@dataclass(frozen=True)
class CalibrationReport:
    """A calibration's figures and sentences.

    Attributes:
        frames: Frames in the fit.
        heldout_frames: Frames left out of it.
        missing_fraction: Share of the marker samples that were not measured.
        fit_rms: Root mean square distance [m] of markers from the model in the frames of the fit.
        heldout_mean: Mean distance [m] in the frames left out; NaN when there are none.
        seconds: Wall time of the fit [s].
        markers: One entry for each marker.
        joints: One entry for each displacement.
        problems: Why the skeleton must not be used, and what to do.
        advice: How it could become better.
    """

    frames: int
    heldout_frames: int
    missing_fraction: float
    fit_rms: float
    heldout_mean: float
    seconds: float
    markers: tuple[MarkerError, ...]
    joints: tuple[JointQuality, ...]
    problems: tuple[str, ...]
    advice: tuple[str, ...]

    @property
    def usable(self) -> bool:
        """Whether the skeleton may be used."""
        return not self.problems
