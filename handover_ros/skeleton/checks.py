"""Looks at marker frames before a skeleton is fitted, and at the skeleton after: what is wrong, and what to do."""

from __future__ import annotations

import numpy as np

from handover_ros.errors import BadRecordingError, ErrorCode
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import Recording
from handover_ros.skeleton.templates import MINIMUM_ROOT_MARKERS, NamedTemplate
from handover_ros.skeleton.tree import WORLD, JointKind, Skeleton

LEAST_FRAMES = 60
SEEN_SHARE = 0.05  # a marker seen in less than this share of the frames does not count
LARGEST_SEGMENT = 1.0  # [m] between two markers of one segment
SMALLEST_DISTANCE = 0.003  # [m]
LARGEST_BEND = 0.03  # [m] by which the distance of two markers on one segment may vary
UNIT_JUMP = 5.0  # factor between the sizes of the person in two frames
WRONG_SIDE_SHARE = 0.25
BACKWARDS = np.deg2rad(30.0)
LEAST_MOTION = {"angle": np.deg2rad(25.0), "length": 0.02}
LARGEST_FIT_RMS = 0.015  # [m]; the dissertation's own mean reprojection error is 14.9 mm
LARGEST_AXIS_ERROR = np.deg2rad(5.0)
LARGEST_POINT_ERROR = 0.015  # [m]
MANY_MISSING = 0.5


def check_amount(recording: Recording, template: NamedTemplate) -> None:
    """Refuse what no skeleton can be fitted to.

    Raises:
        BadRecordingError: Too few frames, or a segment whose markers are never seen (code NOT_ENOUGH_DATA).
    """
    where, content = recording.path, template.content
    if recording.frames < LEAST_FRAMES:
        raise BadRecordingError(
            f"{where}: {recording.frames} frames are too few for a calibration, which needs at least {LEAST_FRAMES} "
            "and should show every joint move through its range; record the calibration motions",
            ErrorCode.NOT_ENOUGH_DATA,
        )
    seen = np.isfinite(recording.positions[:, :, 0]).mean(axis=0) >= SEEN_SHARE
    ends = set(content.segments) - {joint.parent for joint in content.joints}
    for segment in content.segments:
        names = [name for name, own in zip(recording.names, recording.segments) if own == segment]
        shown = [n for n, own, ok in zip(recording.names, recording.segments, seen) if own == segment and ok]
        needed = MINIMUM_ROOT_MARKERS if segment == content.root and segment != WORLD else 1 if segment in ends else 0
        if len(shown) < needed:
            hidden = ", ".join(name for name in names if name not in shown) or "none in the marker set"
            raise BadRecordingError(
                f"{where}: segment {segment!r} shows {len(shown)} markers, template {template.name!r} needs {needed} "
                f"(not seen: {hidden}); uncover or add markers, or choose another template",
                ErrorCode.NOT_ENOUGH_DATA,
            )


def input_problems(recording: Recording, world_from_torso: FloatArray | None, template: NamedTemplate) -> list[str]:
    """Return what is wrong with marker frames: mixed units, labels that change places, left and right swapped.

    Args:
        recording: The frames.
        world_from_torso: Torso pose of each frame (x forward, y left), shape (frames, 4, 4), NaN where unknown; None:
            no torso is known.
        template: The tree.
    """
    problems = unit_problems(recording)
    if problems:
        return problems
    return [*rigidity_problems(recording, template), *side_problems(recording, world_from_torso, template)]


def unit_problems(recording: Recording) -> list[str]:
    """Return which markers or frames seem to be in another unit than the rest."""
    positions = recording.positions
    middle = np.nanmedian(positions, axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        size = np.nanmedian(np.linalg.norm(positions - middle, axis=2), axis=1)
    usual = float(np.nanmedian(size))
    odd = np.flatnonzero((size > UNIT_JUMP * usual) | (size < usual / UNIT_JUMP))
    if len(odd) > 0.01 * len(size):
        ratio = float(np.nanmedian(size[odd])) / usual
        return [
            f"frames {odd[0]} to {odd[-1]} show the person {ratio:.3g} times as large as the others: units are mixed "
            "(mm and m?); bring all frames to one unit"
        ]
    problems = []
    for segment in dict.fromkeys(recording.segments):
        rows = [i for i, own in enumerate(recording.segments) if own == segment]
        typical = np.nanmedian(positions[:, rows], axis=0)
        for i, row in enumerate(rows):
            others = [k for k in range(len(rows)) if k != i]
            if not others or np.isnan(typical[i]).any():
                continue
            distance = float(np.nanmedian(np.linalg.norm(typical[others] - typical[i], axis=1)))
            if distance > LARGEST_SEGMENT:
                problems.append(
                    f"marker {recording.names[row]} lies {distance:.3g} m from the other markers of {segment}: is its "
                    "unit another one, or does it sit on another segment?"
                )
    return problems


def rigidity_problems(recording: Recording, template: NamedTemplate) -> list[str]:
    """Return pairs of markers of one segment whose distance changes more than skin moves."""
    problems = []
    for segment in template.content.segments:
        rows = [i for i, own in enumerate(recording.segments) if own == segment]
        worst: tuple[float, str] = (0.0, "")
        for a, i in enumerate(rows):
            for j in rows[a + 1 :]:
                distance = np.linalg.norm(recording.positions[:, i] - recording.positions[:, j], axis=1)
                distance = distance[np.isfinite(distance)]
                if len(distance) < 10:
                    continue
                spread = float(np.subtract(*np.quantile(distance, [0.95, 0.05])))
                if spread > worst[0]:
                    worst = spread, f"{recording.names[i]} and {recording.names[j]}"
        if worst[0] > 2.0 * LARGEST_BEND:
            problems.append(
                f"markers {worst[1]} of {segment} change their distance by {1e3 * worst[0]:.0f} mm, so they are not on "
                "one rigid segment: look for swapped labels, or change their segment in the marker set"
            )
    return problems


def side_problems(recording: Recording, world_from_torso: FloatArray | None, template: NamedTemplate) -> list[str]:
    """Return the limbs whose markers are on the other side of the body than their name says."""
    if world_from_torso is None:
        return []
    problems = []
    first: dict[str, str] = {}
    for joint in template.content.joints:
        if joint.side and joint.side not in first and joint.segment in recording.segments:
            first[joint.side] = joint.segment
    for side, segment in first.items():
        rows = [i for i, own in enumerate(recording.segments) if own == segment]
        centre = recording.positions[:, rows] - world_from_torso[:, None, :3, 3]
        lateral = np.einsum("fma,fa->fm", centre, world_from_torso[:, :3, 1])
        lateral = lateral[np.isfinite(lateral)]
        wrong = float(np.mean(lateral < 0.0 if side == "left" else lateral > 0.0)) if len(lateral) else 0.0
        if wrong > WRONG_SIDE_SHARE:
            problems.append(
                f"the markers of {segment} are on the other side of the torso in {100 * wrong:.0f} % of the frames: "
                "left and right are swapped; swap the labels of the arms, or those of the torso"
            )
    return problems


def fit_problems(
    skeleton: Skeleton, fit_rms: float, marker_rms: dict[str, float], template: NamedTemplate
) -> list[str]:
    """Return why a fitted skeleton must not be used."""
    problems = []
    if not fit_rms <= LARGEST_FIT_RMS:
        worst = sorted((value, name) for name, value in marker_rms.items() if np.isfinite(value))[-3:]
        names = ", ".join(f"{name} {1e3 * value:.0f} mm" for value, name in reversed(worst))
        problems.append(
            f"the skeleton does not explain the markers: {1e3 * fit_rms:.1f} mm rms (limit "
            f"{1e3 * LARGEST_FIT_RMS:.0f} mm), worst {names}; look for swapped labels (left and right?), "
            "loose markers, or choose another template"
        )
    for joint in template.content.joints:
        if not joint.one_way or joint.displacements[0] not in skeleton.displacement_names:
            continue
        index = skeleton.displacement_names.index(joint.displacements[0])
        low, high = skeleton.lower[index], skeleton.upper[index]
        if low < -BACKWARDS and -low > 2.0 * high:
            problems.append(
                f"{joint.displacements[0]} bends backwards by {np.rad2deg(-low):.0f} deg from standing: left and right "
                "of the torso, or its front and back, are swapped; mend the labels"
            )
    return problems


def motion_advice(skeleton: Skeleton, moved: FloatArray) -> list[str]:
    """Return the joints that did not move enough, given the range (n,) [rad] or [m] each displacement covered."""
    advice = []
    for index, name in enumerate(skeleton.displacement_names):
        joint = skeleton.joints[int(skeleton.displacement_joints[index])]
        words = name.replace("_", " ")
        if joint.kind is JointKind.PRISMATIC:
            if moved[index] < LEAST_MOTION["length"]:
                advice.append(f"{words} moved {1e3 * moved[index]:.0f} mm: move it through its full range")
        elif moved[index] < LEAST_MOTION["angle"]:
            advice.append(f"{words} moved {np.rad2deg(moved[index]):.0f} deg: move it through its full range")
    return advice


def certainty_advice(names: list[str], axis_errors: FloatArray, point_errors: FloatArray) -> list[str]:
    """Return the joints whose place or direction is badly known, given standard errors [rad] and [m] of each joint."""
    advice = []
    for name, axis, point in zip(names, axis_errors, point_errors):
        words = name.replace("_", " ")
        if axis > LARGEST_AXIS_ERROR:
            advice.append(
                f"the axis of {words} is known to {np.rad2deg(min(axis, np.pi)):.0f} deg only: move it farther, slowly"
            )
        elif point > LARGEST_POINT_ERROR:
            advice.append(
                f"the place of {words} is known to {1e3 * min(point, 1.0):.0f} mm only: move it farther, in all its "
                "directions"
            )
    return advice


def missing_advice(recording: Recording) -> list[str]:
    """Return the markers that were hidden most of the time."""
    missing = np.isnan(recording.positions[:, :, 0]).mean(axis=0)
    return [
        f"marker {name} was hidden in {100 * share:.0f} % of the frames: uncover it"
        for name, share in zip(recording.names, missing)
        if share > MANY_MISSING
    ]
