"""Random skeletons for property tests: free or fixed roots, branches, revolute, prismatic and ball joints."""

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton

KINDS = (JointKind.REVOLUTE, JointKind.PRISMATIC, JointKind.BALL)


def random_skeleton(seed, joints=6, free=True):
    """Return a skeleton with random kinds, branches, axes, points and markers."""
    rng = np.random.default_rng(seed)
    segments = ["body" if free else WORLD]
    made = [Joint("body", JointKind.FREE, WORLD, "body", (), np.zeros((0, 3)), np.zeros(3))] if free else []
    for index in range(joints):
        kind = KINDS[rng.integers(3)]
        count = 3 if kind is JointKind.BALL else 1
        made.append(
            Joint(
                f"joint{index}",
                kind,
                segments[rng.integers(len(segments))],
                f"segment{index}",
                tuple(f"move{index}_{k}" for k in range(count)),
                Rotation.random(rng=rng).as_matrix()[:count],
                rng.normal(size=3),
            )
        )
        segments.append(made[-1].segment)
    size = sum(len(joint.displacement_names) for joint in made)
    return Skeleton(
        name="random",
        joints=tuple(made),
        marker_names=tuple(f"m{k}" for k in range(joints)),
        marker_segments=tuple(segments[1:]),
        markers=rng.normal(size=(joints, 3)),
        lower=np.full(size, -2.0),
        upper=np.full(size, 2.0),
    )


def random_pose(rng):
    """Return a random transform (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    pose[:3, 3] = rng.normal(size=3)
    return pose


def pinocchio_posture(model, skeleton, displacements):
    """Return pinocchio's configuration of displacements."""
    q = np.zeros(model.nq)
    for name, value in zip(skeleton.displacement_names, displacements):
        q[model.joints[model.getJointId(name)].idx_q] = value
    return q
