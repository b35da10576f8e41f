"""An arm that swings as one rod."""

import numpy as np

from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton


def pendulum(length=0.7):
    """A rod that hangs on one hinge: an upper arm with a forearm that cannot turn against it."""
    axis = np.array([[0.0, -1.0, 0.0]])
    joints = (
        Joint("shoulder", JointKind.REVOLUTE, WORLD, "right_upper_arm", ("swing",), axis, np.zeros(3)),
        Joint(
            "elbow", JointKind.REVOLUTE, "right_upper_arm", "right_forearm", ("bend",), axis, np.array([0, 0, -length])
        ),
    )
    limits = np.array([3.0, 2.0])
    return Skeleton("pendulum", joints, ("m",), ("right_forearm",), np.array([[0, 0, -1.0]]), -limits, limits)
