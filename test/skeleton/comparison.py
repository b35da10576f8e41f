"""How far a calibrated skeleton is from the true one, whatever zero posture and zero frame each has."""

from dataclasses import dataclass

import numpy as np

from handover_ros.skeleton.gauge import with_zero_at
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.tree import JointKind


@dataclass(frozen=True)
class Differences:
    """Estimate against truth; joints by name, limits by displacement name."""

    centres: dict  # [m] of balls; of revolute joints the distance of the axes
    axes: dict  # [rad]
    lower: dict  # [rad] or [m]
    upper: dict


def compare(truth, estimate):
    """Return the differences after moving the true skeleton into the zero posture and zero frame of the estimate.

    That posture is the one in which the true skeleton's markers fit the estimate's zero markers best.
    """
    zero_markers = estimate.markers[[estimate.marker_names.index(name) for name in truth.marker_names]]
    posture, _ = solve_postures(truth.tree, truth.zero, zero_markers[None])
    pose = truth.world_from_root(posture)[0]
    tree, _ = with_zero_at(truth.tree, truth.zero[None], posture[0])
    centres, axes = {}, {}
    for j, joint in enumerate(estimate.joints):
        if joint.kind is JointKind.FREE:
            continue
        point = pose[:3, :3] @ tree.point[j] + pose[:3, 3]
        shift = point - joint.point
        if joint.kind is JointKind.BALL:
            centres[joint.name] = float(np.linalg.norm(shift))
            continue
        direction = pose[:3, :3] @ tree.axis[j]
        axes[joint.name] = float(np.arccos(np.clip(joint.axes[0] @ direction, -1.0, 1.0)))
        if joint.kind is JointKind.REVOLUTE:
            centres[joint.name] = float(np.linalg.norm(np.cross(joint.axes[0], shift)))
    moved = truth.displacements(posture, near=np.zeros(len(truth.lower)))[0]
    names = estimate.displacement_names
    revolute = {name: truth.joints[j].kind is not JointKind.BALL for name, j in zip(names, truth.displacement_joints)}
    shift = np.where([revolute[name] for name in names], moved, 0.0)
    lower = dict(zip(names, estimate.lower - (truth.lower - shift)))
    upper = dict(zip(names, estimate.upper - (truth.upper - shift)))
    return Differences(centres, axes, lower, upper)
