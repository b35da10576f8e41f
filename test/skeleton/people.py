"""Synthetic people: random limbs, axes and limits, and the markers of their calibration motions."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.templates import blank_skeleton, load_template
from handover_ros.skeleton.tree import JointKind, Skeleton

ARM_LIMITS = np.array([[-0.8, 2.6], [-0.4, 1.9], [-1.0, 1.2], [-0.15, 2.3], [-1.3, 1.2], [-1.1, 1.1], [-0.5, 0.4]])
SEGMENTS = (
    *["torso"] * 8,
    *["right_upper_arm"] * 3,
    *["right_forearm"] * 3,
    *["right_hand"] * 2,
    *["left_upper_arm"] * 3,
    *["left_forearm"] * 3,
    *["left_hand"] * 2,
)
NAMES = (
    *(f"{group}{i}" for group in ("CHEST", "BACK") for i in range(1, 5)),
    *(f"{group}{i}" for group in ("RARM", "LARM") for i in range(1, 9)),
)


@dataclass(frozen=True)
class Motion:
    """What a motion-capture system saw of a person, and the truth."""

    skeleton: Skeleton
    displacements: np.ndarray
    coordinates: np.ndarray
    measured: np.ndarray
    rate: float


def tilted(direction, angle, rng):
    """Return a unit direction turned by up to ``angle`` [rad] about a random axis."""
    vector = rng.normal(size=3)
    vector *= rng.uniform(0.0, angle) / np.linalg.norm(vector)
    return Rotation.from_rotvec(vector).apply(direction)


def random_person(seed: int, tilt: float = 0.35) -> Skeleton:
    """Return a two-armed person of the template upper_body with the 24 markers of the dissertation."""
    rng = np.random.default_rng(seed)
    blank = blank_skeleton(load_template("upper_body"), NAMES, SEGMENTS)
    points, axes = np.zeros((len(blank.joints), 3)), blank.tree.axis.copy()
    place = {"torso": np.array([0.0, 0.0, -0.12])}
    half, upper, fore = rng.uniform(0.15, 0.21), rng.uniform(0.26, 0.36), rng.uniform(0.21, 0.29)
    for index, joint in enumerate(blank.joints):
        side = -1.0 if joint.name.startswith("right") else 1.0
        shoulder = np.array([rng.uniform(-0.02, 0.02), side * half, rng.uniform(-0.02, 0.02)])
        bent = np.array([0.05, side * 0.03, 0.0])
        if joint.kind is JointKind.BALL:
            points[index] = shoulder
            place[joint.segment] = shoulder
            continue
        if joint.kind is JointKind.FREE:
            continue
        axes[index] = tilted(axes[index], tilt, rng)
        parent = place[joint.parent]
        step = {"elbow": [0.0, 0.0, -upper], "wrist": [0.0, 0.0, -fore] + bent}.get(
            joint.name.partition("_")[2], [0, 0, 0]
        )
        points[index] = parent + step
        if joint.name.endswith("_forearm"):
            points[index] = parent + rng.normal(size=3) * 0.004
        place[joint.segment] = points[index]
    markers = []
    for name, segment in zip(NAMES, SEGMENTS):
        number = int(name[-1])
        side = -1.0 if segment.startswith("right") else 1.0
        if segment == "torso":
            front = 0.11 if name.startswith("CHEST") else -0.10
            spot = [front, 0.07 if number % 2 else -0.07, -0.04 if number < 3 else -0.22]
        elif segment.endswith("upper_arm"):
            spot = place[segment] + [0.04 * np.cos(2.1 * number), side * 0.045 * np.sin(2.1 * number), -0.08 * number]
        elif segment.endswith("forearm"):
            spot = place[segment] + [0.04 * np.cos(2.3 * number), 0.04 * np.sin(2.3 * number), -0.07 * (number - 3)]
        else:
            spot = place[segment] + [0.03 if number == 7 else -0.03, side * 0.02, -0.075 if number == 7 else -0.057]
        markers.append(np.asarray(spot) + rng.normal(size=3) * 0.008)
    limits = np.vstack([ARM_LIMITS, ARM_LIMITS]) + rng.uniform(-0.12, 0.12, size=(14, 2))
    return blank.with_geometry(axes, points, np.array(markers)).with_limits(limits[:, 0], limits[:, 1])


def calibration_motion(
    skeleton: Skeleton,
    frames: int = 1500,
    rate: float = 50.0,
    noise: float = 0.001,
    missing: float = 0.1,
    seed: int = 0,
) -> Motion:
    """Return the markers of a person who stands still, then moves each joint through its range three times
    and draws circles with the hands."""
    rng = np.random.default_rng(seed + 1000)
    count = len(skeleton.displacement_names)
    still = max(frames // 30, 5)
    per_arm = 7
    displacements = np.zeros((frames, count))
    bounds = np.linspace(still, frames, per_arm + 2).astype(int)
    for block in range(per_arm + 1):
        start, stop = bounds[block], bounds[block + 1]
        phase = np.linspace(0.0, 1.0, stop - start)
        ramp = np.clip(
            np.minimum(phase, 1.0 - phase) * (stop - start) / rate / min(0.6, 0.2 * (stop - start) / rate), 0.0, 1.0
        )
        blend = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)  # minimum jerk
        for arm in range(count // per_arm):
            # The last block draws circles with the hands: both joints of the wrist at once.
            moving = ((block, 0.0),) if block < per_arm else ((per_arm - 2, 0.0), (per_arm - 1, 0.5 * np.pi))
            for joint, lag in moving:
                own = arm * per_arm + joint
                low, high = skeleton.lower[own], skeleton.upper[own]
                sweep = 0.5 * (high + low) - 0.5 * (high - low) * np.cos(2.0 * np.pi * 3.0 * phase + arm + lag)
                displacements[start:stop, own] = blend * sweep
            elbow = arm * per_arm + 3
            if block in (2, 4, 5, 6, 7):
                displacements[start:stop, elbow] = blend * 1.4
            if block in (5, 6):  # each axis of the wrist at three places of the other
                other = arm * per_arm + 11 - block
                low, high = skeleton.lower[other], skeleton.upper[other]
                place = np.interp(phase, [0.0, 0.3, 0.37, 0.63, 0.7, 1.0], [-1.0, -1.0, 0.0, 0.0, 1.0, 1.0])
                displacements[start:stop, other] = blend * 0.5 * ((high + low) + 0.9 * place * (high - low))
    displacements += 0.03 * np.sin(
        np.outer(np.arange(frames) / rate, rng.uniform(0.5, 2.0, count)) + rng.uniform(0, 6, count)
    )
    displacements[:still] *= np.linspace(0.0, 1.0, still)[:, None] ** 2 * 0.2
    displacements = np.clip(displacements, skeleton.lower, skeleton.upper)
    times = np.arange(frames) / rate
    poses = np.tile(np.eye(4), (frames, 1, 1))
    sway = np.column_stack([0.1 * np.sin(0.4 * times), 0.05 * np.sin(0.7 * times), 0.2 * np.sin(0.3 * times)])
    poses[:, :3, :3] = Rotation.from_euler("xyz", sway).as_matrix()
    poses[:, :3, 3] = [0.3, 0.2, 1.4] + 0.02 * sway
    coordinates = skeleton.coordinates(displacements, poses if skeleton.is_free else None)
    measured = forward(skeleton.tree, coordinates) + noise * rng.normal(size=(frames, len(skeleton.marker_names), 3))
    measured[rng.random(measured.shape[:2]) < missing] = np.nan
    return Motion(skeleton, displacements, coordinates, measured, rate)


def right_arm_of(person: Skeleton) -> Skeleton:
    """Return the torso and right arm of a two-armed person, as the template right_arm has them."""
    kept = [i for i, segment in enumerate(person.marker_segments) if not segment.startswith("left")]
    names, segments = (tuple(all_of[i] for i in kept) for all_of in (person.marker_names, person.marker_segments))
    tree = person.tree
    blank = blank_skeleton(load_template("right_arm"), names, segments)
    count = len(blank.joints)
    arm = blank.with_geometry(tree.axis[:count], tree.point[:count], tree.marker[kept])
    return arm.with_limits(person.lower[:7], person.upper[:7])


def two_dof_person(seed: int) -> Skeleton:
    """Return a person of figure 2.4: shoulder and elbow turn about one axis each."""
    rng = np.random.default_rng(seed)
    names = tuple(f"M{i}" for i in range(10))
    segments = (*["torso"] * 4, *["right_upper_arm"] * 3, *["right_forearm"] * 3)
    blank = blank_skeleton(load_template("two_dof_arm"), names, segments)
    axes = blank.tree.axis.copy()
    points = np.array([[0.0, 0.0, 0.0], [0.0, -0.18, 0.0], [0.0, -0.2, -0.3]]) + 0.02 * rng.normal(size=(3, 3))
    axes[1], axes[2] = tilted(axes[1], 0.4, rng), tilted(axes[2], 0.4, rng)
    spots = np.array([[0.1, 0.08, -0.1], [0.1, -0.08, -0.12], [-0.1, 0.07, -0.1], [0.1, 0.0, -0.3]])
    arm = [points[joint] + 0.06 * rng.normal(size=3) - [0.0, 0.0, 0.08 * k] for joint in (1, 2) for k in range(1, 4)]
    skeleton = blank.with_geometry(axes, points, np.vstack([spots, arm]))
    return skeleton.with_limits([-0.7, -0.1], [2.2, 2.1])


def drawer_cabinet(seed: int) -> Skeleton:
    """Return an articulated object fixed in the room: a drawer that slides, a flap on it that turns."""
    rng = np.random.default_rng(seed)
    names = tuple(f"M{i}" for i in range(7))
    segments = (*["drawer"] * 4, *["flap"] * 3)
    blank = blank_skeleton(load_template("drawer_cabinet"), names, segments)
    axes = np.array([tilted(axis, 0.3, rng) for axis in blank.tree.axis])
    points = np.array([[0.0, 0.0, 0.0], [1.2, 0.3, 0.9]]) + 0.02 * rng.normal(size=(2, 3))
    spots = np.array([1.1, 0.2, 0.8]) + rng.uniform(-0.15, 0.15, (7, 3))
    return blank.with_geometry(axes, points, spots).with_limits([-0.005, -0.05], [0.38, 1.5])


def sweeps(skeleton: Skeleton, frames: int = 900, rate: float = 50.0, noise: float = 0.001, seed: int = 0) -> Motion:
    """Return the markers of somebody who stands still, then moves one displacement after the other three times."""
    rng = np.random.default_rng(seed + 2000)
    count, still = len(skeleton.displacement_names), frames // 15
    displacements = np.zeros((frames, count))
    bounds = np.linspace(still, frames, count + 1).astype(int)
    for own, (start, stop) in enumerate(pairwise(bounds)):
        phase = np.linspace(0.0, 1.0, stop - start)
        blend = np.minimum(1.0, 8.0 * np.minimum(phase, 1.0 - phase))
        low, high = skeleton.lower[own], skeleton.upper[own]
        displacements[start:stop, own] = blend * (
            0.5 * (high + low) - 0.5 * (high - low) * np.cos(2.0 * np.pi * 3.0 * phase)
        )
    times = np.arange(frames) / rate
    poses = np.tile(np.eye(4), (frames, 1, 1))
    sway = np.column_stack([0.1 * np.sin(0.4 * times), 0.05 * np.sin(0.7 * times), 0.2 * np.sin(0.3 * times)])
    poses[:, :3, :3] = Rotation.from_euler("xyz", sway).as_matrix()
    poses[:, :3, 3] = [0.3, 0.2, 1.4] + 0.02 * sway
    coordinates = skeleton.coordinates(displacements, poses if skeleton.is_free else None)
    measured = forward(skeleton.tree, coordinates) + noise * rng.normal(size=(frames, len(skeleton.marker_names), 3))
    measured[rng.random(measured.shape[:2]) < 0.1] = np.nan
    return Motion(skeleton, displacements, coordinates, measured, rate)
