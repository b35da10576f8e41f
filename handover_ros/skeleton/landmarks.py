"""Joint centres: of each joint's axis, which any of its points describes, the one point that anatomy would name."""

from __future__ import annotations

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton

PARALLEL = 1e-6


def nearest_on_axis(joint: Joint, point: FloatArray) -> FloatArray:
    """Return the point (3,) [m] of a joint's axis, zero frame, that is nearest to a point (3,)."""
    axis = joint.axes[0]
    return np.asarray(joint.point + axis * (axis @ (point - joint.point)))


def axes_meet(first: Joint, second: Joint) -> tuple[FloatArray, float]:
    """Return where two axes come nearest to each other: the middle between them (3,) [m] and their distance [m].

    Parallel axes are nearest everywhere; then it is the middle at the first joint's point.
    """
    a, b, offset = first.axes[0], second.axes[0], second.point - first.point
    cosine = float(a @ b)
    sine2 = 1.0 - cosine**2
    along = 0.0 if sine2 < PARALLEL else float(offset @ a - cosine * (offset @ b)) / sine2
    one = first.point + along * a
    other = nearest_on_axis(second, one)
    return 0.5 * (one + other), float(np.linalg.norm(other - one))


def joint_centres(skeleton: Skeleton) -> FloatArray:
    """Return one point of each joint in the zero frame, (joints, 3) [m].

    A ball joint's and a prismatic joint's own point; of a revolute axis the point nearest to the centre before it, so
    that consecutive centres are a bone's length apart; the first revolute axis takes the point nearest to the markers
    it moves.
    """
    centres = np.zeros((len(skeleton.joints), 3))
    for index, joint in enumerate(skeleton.joints):
        parent = int(skeleton.tree.parent[index])
        before = None if parent < 0 or skeleton.joints[parent].kind is JointKind.FREE else centres[parent]
        if joint.kind is not JointKind.REVOLUTE:
            centres[index] = joint.point
            continue
        if before is None:
            before = marker_centroid(skeleton, joint.segment)
        centres[index] = joint.point if before is None else nearest_on_axis(joint, before)
    return centres


def marker_centroid(skeleton: Skeleton, segment: str) -> FloatArray | None:
    """Return the mean position (3,) [m] of a segment's markers in the zero frame, None where it carries none."""
    rows = [row for row, carrier in enumerate(skeleton.marker_segments) if carrier == segment]
    return np.asarray(skeleton.markers[rows].mean(axis=0)) if rows else None


def children_of(skeleton: Skeleton, segment: str) -> tuple[int, ...]:
    """Return the joints that hang on a segment."""
    return tuple(index for index, joint in enumerate(skeleton.joints) if joint.parent == segment)


def bones(skeleton: Skeleton) -> tuple[tuple[str, FloatArray, FloatArray], ...]:
    """Return the lines of a stick figure: segment, start and end (3,) [m] in the zero frame.

    From a segment's own joint centre to those that hang on it, or to its markers' centroid where none does. The root
    has no joint centre of its own: its lines start at the middle of what hangs on it, and one ends at its markers.
    """
    centres = joint_centres(skeleton)
    lines: list[tuple[str, FloatArray, FloatArray]] = []
    for segment in dict.fromkeys((skeleton.root, *(joint.segment for joint in skeleton.joints))):
        carrier = skeleton.joint_carrying(segment)
        is_root = segment == skeleton.root
        hanging = [centres[index] for index in children_of(skeleton, segment)]
        centroid = marker_centroid(skeleton, segment)
        if is_root:
            if segment == WORLD and centroid is None:
                continue
            start = np.mean(hanging, axis=0) if hanging else np.zeros(3)
        else:
            start = centres[carrier]
        ends = hanging if hanging and not is_root else [*hanging, *([] if centroid is None else [centroid])]
        lines += [(segment, start, end) for end in ends if np.linalg.norm(end - start) > PARALLEL]
    return tuple(lines)
