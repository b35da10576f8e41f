"""The plain twin of the compiled inverse kinematics of an arm: dense grids of swivel angles, rotations from scipy.

One look at every angle of a grid, so that it cannot be wrong by much and cannot find what lies between its points.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from handover_ros.arm.model import AXES, Arm
from handover_ros.geometry import FloatArray

BRANCHES = 8
FOLDED = 1e-9  # [m] between shoulder and wrist: the line between them has no direction
STRAIGHT = 4e-15  # of the cosine of the elbow's bend: rounding
NO_LOWEST = 1e-6  # horizontal part of a line's direction: its circle has no lowest point
DOWN, FRONT = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])


def postures(arm: Arm, torso_from_hand: FloatArray, swivels: FloatArray) -> FloatArray:
    """Return the displacements (8, k, 7) [rad] of all branches at swivel angles (k,) of a hand pose (4, 4).

    Angles are those nearest to the middle of their limits, within them or not; NaN: out of reach, or the elbow
    backwards of a straight arm, which is the same. Where a middle angle is a right angle, scipy chooses between the
    outer two.
    """
    hand = arm.segment_poses(torso_from_hand)[0]
    shoulder, wrist = arm.right_shoulder, hand[:3, 3]
    result = np.full((BRANCHES, len(swivels), 7), np.nan)
    distance = float(np.linalg.norm(wrist - shoulder))
    # Cosine rule: the elbow's bend is half a turn less the angle between upper arm and forearm.
    cosine = (distance**2 - arm.upper_arm**2 - arm.forearm**2) / (2.0 * arm.upper_arm * arm.forearm)
    if abs(cosine) > 1.0 + 1e-12:
        return result
    bend = 0.0 if cosine > 1.0 - STRAIGHT else float(np.arccos(max(cosine, -1.0)))
    line, low = swivel_axes(shoulder, wrist)
    out = Rotation.from_rotvec(-swivels[:, None] * line).apply(low)  # from the line to the elbow, shape (k, 3)
    at_shoulder = np.arctan2(arm.forearm * np.sin(bend), arm.upper_arm + arm.forearm * np.cos(bend))
    up = -(np.cos(at_shoulder) * line + np.sin(at_shoulder) * out)  # from elbow to shoulder
    for elbow in (0, 1) if bend > 0.0 else (0,):
        angle = -bend if elbow else bend
        side = -np.cross(line, out) if elbow else np.cross(line, out)
        upper = np.stack([np.cross(side, up), side, up], axis=-1)
        fore = upper @ Rotation.from_rotvec(angle * AXES[3]).as_matrix()
        turned = np.swapaxes(fore, -1, -2) @ hand[:3, :3]
        at_upper = Rotation.from_matrix(upper).as_euler("YXZ") * [-1.0, -1.0, 1.0]
        at_hand = Rotation.from_matrix(turned).as_euler("ZXY") * [1.0, 1.0, -1.0]
        for over in (0, 1):
            for wrist_over in (0, 1):
                q = result[elbow + 2 * over + 4 * wrist_over]
                q[:, 0:3] = other_triple(at_upper) if over else at_upper
                q[:, 3] = angle
                q[:, 4:7] = other_triple(at_hand) if wrist_over else at_hand
    middle = arm.limits.mean(axis=0)
    return np.asarray(result - 2.0 * np.pi * np.round((result - middle) / (2.0 * np.pi)))


def swivel_axes(shoulder: FloatArray, wrist: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the direction from shoulder to wrist and, at a right angle, that to the elbow at swivel zero: the lowest.

    On a vertical line the elbow is then in front; the line of a folded arm, wrist at the shoulder, points down.
    """
    line = wrist - shoulder
    distance = float(np.linalg.norm(line))
    line = line / distance if distance > FOLDED else DOWN
    towards = DOWN if np.hypot(line[0], line[1]) > NO_LOWEST else FRONT
    low = towards - towards @ line * line
    return line, low / np.linalg.norm(low)


def other_triple(angles: FloatArray) -> FloatArray:
    """Return the other Euler angles (k, 3) of the same rotations [rad]."""
    return np.stack([angles[:, 0] + np.pi, np.pi - angles[:, 1], angles[:, 2] + np.pi], axis=-1)


def place_of(arm: Arm, displacements: FloatArray) -> tuple[int, float]:
    """Return branch and swivel angle [rad], 0 to 2 pi, of a posture (7,), the straight arm's too."""
    turns = [Rotation.from_rotvec(angle * axis) for angle, axis in zip(displacements, AXES)]
    upper = (turns[0] * turns[1] * turns[2]).as_matrix()
    fore = upper @ turns[3].as_matrix()
    line, low = swivel_axes(np.zeros(3), -arm.upper_arm * upper[:, 2] - arm.forearm * fore[:, 2])
    backwards = bool(displacements[3] < 0.0)
    out = np.cross(-upper[:, 1] if backwards else upper[:, 1], line)
    branch = backwards + 2 * bool(np.cos(displacements[1]) < 0.0) + 4 * bool(np.cos(displacements[5]) < 0.0)
    return branch, float(np.arctan2(out @ np.cross(low, line), out @ low) % (2.0 * np.pi))


def feasible_swivels(
    arm: Arm, torso_from_hand: FloatArray, swivels: FloatArray, tolerance: float = 1e-9
) -> npt.NDArray[np.bool_]:
    """Return on which branches (8, k) swivel angles (k,) put every joint within its limits."""
    return arm.within_limits(postures(arm, torso_from_hand, swivels), tolerance)


def best_posture(
    arm: Arm, torso_from_hand: FloatArray, neutral: FloatArray, weights: FloatArray, swivels: FloatArray
) -> tuple[FloatArray, float]:
    """Return the posture (7,) [rad] of least sum w (q - q*)^2 on a grid of swivel angles (k,), and its cost.

    NaN and inf: nothing feasible on the grid.
    """
    q = postures(arm, torso_from_hand, swivels)
    costs = np.where(arm.within_limits(q), ((q - neutral) ** 2) @ weights, np.inf)
    branch, index = np.unravel_index(int(np.argmin(costs)), costs.shape)
    if not np.isfinite(costs[branch, index]):
        return np.full(7, np.nan), np.inf
    return q[branch, index], float(costs[branch, index])
