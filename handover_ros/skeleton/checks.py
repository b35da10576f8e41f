"""Looks at marker frames before a skeleton is fitted, and at the skeleton after: what is wrong, and what to do."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadRecordingError, ErrorCode
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import Recording
from handover_ros.skeleton.templates import MINIMUM_ROOT_MARKERS, NamedTemplate
from handover_ros.skeleton.tree import WORLD, JointKind, Skeleton

LEAST_FRAMES = 60
NUMBERS_SEEN = (0, 3, 5, 6)  # of a segment's pose by 0, 1, 2, 3 or more markers
SPARE_NUMBERS = 2  # in each frame beyond the displacements before a segment; with less, other axes fit as well
SEEN_SHARE = 0.05  # a marker seen in less than this share of the frames does not count
LARGEST_SEGMENT = 1.0  # [m] between a marker and the nearest one of its segment
SMALLEST_SEGMENT = 0.003  # [m] between the markers of a segment that are farthest apart
LARGEST_BEND = 0.04  # [m] by which a distance on one segment may vary; skin and fingers in real recordings: 26 mm
UNIT_JUMP = 5.0  # factor between the sizes of the person in two frames
FEW_SAMPLES = 10  # a distance seen less often than this says nothing
SWAP_JUMP = 0.015  # [m] from one frame to the next
SWAP_RATIO = 0.5  # exchanging labels shortens the jumps to less than this; a segment would have to turn by 127 deg
SWAP_GAP = 0.04  # [s] over which a hidden marker's last and next place are used
SWAP_SHARE = 0.01  # of the time under the other's name; less does not spoil a robust fit
OUTLYING = 4.0  # times the usual error of a marker; skin in real recordings: 2.4
OUTLYING_ERROR = 0.006  # [m]
WRONG_SIDE_SHARE = 0.25
BACKWARDS = np.deg2rad(30.0)
MOTION_FRAMES, MOTION_PERCENTILES = 600, (1.0, 99.0)
LEAST_APPROACH = 0.03  # [m] that markers of different segments come nearer to or go farther from each other
LEAST_MOTION = {"angle": np.deg2rad(25.0), "length": 0.02}
LARGEST_FIT_RMS = 0.015  # [m]; the dissertation's own mean reprojection error is 14.9 mm
LARGEST_AXIS_ERROR = np.deg2rad(5.0)
LARGEST_POINT_ERROR = 0.015  # [m]
MANY_MISSING = 0.5
VAGUE = {"angle": np.deg2rad(20.0), "length": 0.05}  # standard deviation of a displacement in a single frame


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
    shown: dict[str, list[str]] = {segment: [] for segment in content.segments}
    unseen: dict[str, list[str]] = {segment: [] for segment in content.segments}
    for name, segment, enough in zip(recording.names, recording.segments, seen):
        if segment in shown:
            (shown if enough else unseen)[segment].append(name)
    unplaced = displacements_between(template, {segment for segment, names in shown.items() if names} | ends)
    for segment, names in shown.items():
        needed = MINIMUM_ROOT_MARKERS if segment == content.root and segment != WORLD else 1 if segment in ends else 0
        count = unplaced.get(segment, 0)
        if count:
            needed = next((k for k, numbers in enumerate(NUMBERS_SEEN) if numbers >= count + SPARE_NUMBERS), 3)
        if len(names) < needed:
            hidden = unseen[segment] or [name for each in content.segments for name in unseen[each]]
            raise BadRecordingError(
                f"{where}: segment {segment!r} shows {len(names)} markers, template {template.name!r} needs {needed} "
                + (f"for {count} displacements between it and the next markers " if count else "")
                + f"(not seen: {', '.join(hidden) or 'none in the marker set'}); uncover or add markers, or choose "
                "another template",
                ErrorCode.NOT_ENOUGH_DATA,
            )


def displacements_between(template: NamedTemplate, segments: set[str]) -> dict[str, int]:
    """Return for each of some segments the number of displacements between it and the next of them towards the root.

    Joints that two of them share count for the first one only.
    """
    joints = {joint.segment: joint for joint in template.content.joints}
    counted: set[str] = set()
    result = {}
    for segment in joints:
        if segment not in segments:
            continue
        at, count = segment, 0
        while at in joints and at not in counted:
            counted.add(at)
            count += len(joints[at].displacements)
            at = joints[at].parent
        result[segment] = count
    return result


def input_problems(recording: Recording, world_from_torso: FloatArray | None, template: NamedTemplate) -> list[str]:
    """Return what is wrong with marker frames: mixed units, no motion, labels that change places, sides swapped.

    Args:
        recording: The frames.
        world_from_torso: Torso pose of each frame (x forward, y left), shape (frames, 4, 4), NaN where unknown; None:
            no torso is known.
        template: The tree.
    """
    problems = unit_problems(recording) or motionless_problems(recording)
    if problems:
        return problems
    swapped = swap_problems(recording)
    rigid = [] if swapped else rigidity_problems(recording, template)
    return [*swapped, *rigid, *side_problems(recording, world_from_torso, template)]


def segment_distances(recording: Recording) -> dict[tuple[int, int], FloatArray]:
    """Return the distance (frames,) [m] of every two markers of one segment that are seen together often enough."""
    distances = {}
    for i, segment in enumerate(recording.segments):
        for j in range(i + 1, len(recording.segments)):
            if recording.segments[j] == segment:
                distance = np.linalg.norm(recording.positions[:, i] - recording.positions[:, j], axis=1)
                if np.isfinite(distance).sum() >= FEW_SAMPLES:
                    distances[i, j] = distance
    return distances


def motionless_problems(recording: Recording) -> list[str]:
    """Return whether nobody moves: no marker comes nearer to or goes farther from those of other segments."""
    frames = np.linspace(0, recording.frames - 1, min(recording.frames, MOTION_FRAMES)).astype(int)
    most = 0.0
    for i, segment in enumerate(recording.segments):
        others = [j for j in range(i + 1, len(recording.segments)) if recording.segments[j] != segment]
        apart = np.linalg.norm(recording.positions[frames][:, others] - recording.positions[frames, i][:, None], axis=2)
        for distance in apart.T:
            seen = distance[np.isfinite(distance)]
            if len(seen) >= FEW_SAMPLES:
                most = max(most, float(np.ptp(np.percentile(seen, MOTION_PERCENTILES))))
    if most >= LEAST_APPROACH:
        return []
    return [
        f"nobody moves: markers of different segments come nearer or go farther by {1e3 * most:.0f} mm at most; record "
        "the calibration motions, each joint through its full range"
    ]


def unit_problems(recording: Recording) -> list[str]:
    """Return which markers or frames seem to be in another unit than metres, or than the rest.

    Distances on one segment hardly change, whatever the posture and whichever markers are seen: they tell the unit.
    """
    distances = segment_distances(recording)
    if not distances:
        return []
    typical = {pair: float(np.nanmedian(distance)) for pair, distance in distances.items()}
    ratios = np.column_stack([distance / max(typical[pair], 1e-9) for pair, distance in distances.items()])
    frames = np.flatnonzero(np.isfinite(ratios).any(axis=1))
    ratio = np.nanmedian(ratios[frames], axis=1)
    odd = (ratio > UNIT_JUMP) | (ratio < 1.0 / UNIT_JUMP)
    if odd.any():
        return [
            f"{int(odd.sum())} frames between {frames[odd][0]} and {frames[odd][-1]} show the person "
            f"{float(np.median(ratio[odd])):.3g} times as large as the others: units are mixed (mm and m?); bring all "
            "frames to one unit"
        ]
    extents: dict[str, float] = {}
    for (i, _), distance in typical.items():
        extents[recording.segments[i]] = max(extents.get(recording.segments[i], 0.0), distance)
    extent = float(np.median(list(extents.values())))
    if not SMALLEST_SEGMENT < extent < LARGEST_SEGMENT:
        return [
            f"the markers of one segment lie {extent:.3g} m apart (expected {SMALLEST_SEGMENT:g} to "
            f"{LARGEST_SEGMENT:g} m): the recording is in another unit; state its unit in the marker set"
        ]
    problems = []
    for row, name in enumerate(recording.names):
        near = [distance for pair, distance in typical.items() if row in pair]
        if near and min(near) > LARGEST_SEGMENT:
            problems.append(
                f"marker {name} lies {min(near):.3g} m from the other markers of {recording.segments[row]}: bring it "
                "to the unit of the others, or mend its segment in the marker set"
            )
    return problems


def swap_problems(recording: Recording) -> list[str]:
    """Return the pairs of markers that carry each other's name for a part of the time.

    Where labels change places both markers jump to where the other one was just before; no body moves like that.
    """
    gap = round(SWAP_GAP * recording.rate)
    before = remembered(recording.positions, gap)[:-1]
    after = remembered(recording.positions[::-1], gap)[::-1][1:]
    jump = np.linalg.norm(after - before, axis=2)
    jumped = np.nan_to_num(jump) > SWAP_JUMP
    candidates = []
    for i in range(len(recording.names)):
        for j in range(i + 1, len(recording.names)):
            at = np.flatnonzero(jumped[:, i] & jumped[:, j])
            crossed = np.linalg.norm(after[at, i] - before[at, j], axis=1)
            crossed += np.linalg.norm(after[at, j] - before[at, i], axis=1)
            shorter = crossed < SWAP_RATIO * (jump[at, i] + jump[at, j])
            candidates += [(int(k) + 1, length, i, j) for k, length in zip(at[shorter], crossed[shorter])]
    under_other_name: dict[tuple[int, int], npt.NDArray[np.bool_]] = {}
    taken: set[tuple[int, int]] = set()
    for frame, _, i, j in sorted(candidates):  # where several markers jump, the shortest exchange is the true one
        if (frame, i) in taken or (frame, j) in taken:
            continue
        taken |= {(frame, i), (frame, j)}
        under_other_name.setdefault((i, j), np.zeros(recording.frames, dtype=bool))[frame:] ^= True
    found = []
    for (i, j), frames in under_other_name.items():
        share = float(min(frames.mean(), 1.0 - frames.mean()))
        if share > SWAP_SHARE:
            found.append((share, f"{recording.names[i]} and {recording.names[j]}", int(np.argmax(frames))))
    if not found:
        return []
    names = ", ".join(pair for _, pair, _ in found[:4]) + (f" and {len(found) - 4} more" if len(found) > 4 else "")
    return [
        f"markers {names} change places at frame {min(frame for *_, frame in found)} and carry each other's name "
        f"{100 * max(found)[0]:.0f} % of the time: their labels are swapped; mend the labels"
    ]


def remembered(positions: FloatArray, frames: int) -> FloatArray:
    """Return positions (frames, n, 3) with hidden markers at their last place for a number of frames."""
    result = positions.copy()
    for _ in range(frames):
        hidden = np.isnan(result[1:, :, 0])
        if not hidden.any():
            break
        result[1:][hidden] = result[:-1][hidden]
    return result


def rigidity_problems(recording: Recording, template: NamedTemplate) -> list[str]:
    """Return pairs of markers of one segment whose distance changes more than skin moves."""
    worst: dict[str, tuple[float, str]] = {}
    for (i, j), distance in segment_distances(recording).items():
        spread = float(np.subtract(*np.quantile(distance[np.isfinite(distance)], [0.95, 0.05])))
        names = f"{recording.names[i]} and {recording.names[j]}"
        worst[recording.segments[i]] = max(worst.get(recording.segments[i], (0.0, "")), (spread, names))
    return [
        f"markers {worst[segment][1]} of {segment} change their distance by {1e3 * worst[segment][0]:.0f} mm, so they "
        "are not on one rigid segment: look for a loose marker or swapped labels, or mend the segment in the marker set"
        for segment in template.content.segments
        if segment in worst and worst[segment][0] > LARGEST_BEND
    ]


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


def inseparable_joints(skeleton: Skeleton, deviations: FloatArray) -> list[str]:
    """Return the displacements that trade places with others, given their standard deviations (frames, n) [rad] or [m].

    A joint that did not move may be fitted with the axis of its neighbour: the markers fit, but only the sum of the two
    displacements means anything. In a single frame this shows, since no marker tells one from the other.
    """
    usual = np.median(deviations, axis=0)
    prismatic = np.array([skeleton.joints[j].kind is JointKind.PRISMATIC for j in skeleton.displacement_joints])
    vague = np.flatnonzero(usual > np.where(prismatic, VAGUE["length"], VAGUE["angle"]))
    if not len(vague):
        return []
    names = " and ".join(skeleton.displacement_names[i].replace("_", " ") for i in vague)
    worst = int(vague[np.argmax(usual[vague])])
    amount = f"{1e3 * usual[worst]:.0f} mm" if prismatic[worst] else f"{np.rad2deg(min(usual[worst], np.pi)):.0f} deg"
    return [
        f"{names} cannot be told apart (known to {amount} only in each frame): one of them hardly moved, or too few "
        "markers show it; move each by itself through its full range"
    ]


def outlying_markers(skeleton: Skeleton, residuals: FloatArray) -> list[str]:
    """Return the markers that the skeleton explains far worse than the others, given distances (frames, m) [m].

    A few bad frames do not count: the worst twentieth of a marker's distances is not looked at.
    """
    usual = np.full(residuals.shape[1], np.nan)
    for i, column in enumerate(residuals.T):
        seen = column[np.isfinite(column)]
        if len(seen) >= FEW_SAMPLES:
            usual[i] = np.quantile(seen, 0.95)
    if not np.isfinite(usual).any():
        return []
    typical = float(np.nanmedian(usual))
    return [
        f"marker {skeleton.marker_names[i]} of {skeleton.marker_segments[i]} is off by {1e3 * usual[i]:.0f} mm where "
        f"others are off by {1e3 * typical:.1f} mm: it or its neighbour is loose, held still by the system, or on "
        "another segment; fasten it, or mend its segment in the marker set"
        for i in np.flatnonzero(np.nan_to_num(usual) > max(OUTLYING * typical, OUTLYING_ERROR))
    ]


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
    moved = np.where(np.isfinite(skeleton.upper - skeleton.lower), skeleton.upper - skeleton.lower, 0.0)
    if 2 * (few := len(motion_advice(skeleton, moved))) > len(moved):
        problems.append(
            f"{few} of {len(moved)} displacements hardly changed, so that axes and lengths cannot be told: record the "
            "calibration motions, each joint through its full range"
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
