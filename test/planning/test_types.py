"""Requests and snapshots are checked where they enter."""

import numpy as np
import pytest

from handover_ros.errors import BadRequestError
from handover_ros.planning import CellSnapshot, HandoverRequest, TrackedPerson

STRETCHED = np.diag([1.1, 1.0, 1.0, 1.0])
MIRRORED = np.diag([-1.0, 1.0, 1.0, 1.0])
NOWHERE = np.full((4, 4), np.nan)


@pytest.mark.parametrize("pose", [STRETCHED, MIRRORED, NOWHERE, np.eye(3)])
def test_poses_must_be_rigid_and_finite(pose):
    """A goal, an object's or a torso's pose that is none is named."""
    with pytest.raises(BadRequestError, match="goal"):
        HandoverRequest("mug", world_from_goal=pose)
    with pytest.raises(BadRequestError, match="mug"):
        CellSnapshot({}, {"mug": pose})
    with pytest.raises(BadRequestError, match="torso"):
        TrackedPerson(pose)


@pytest.mark.parametrize("budget", [-1.0, float("nan"), float("inf")])
def test_time_budget_must_be_usable(budget):
    with pytest.raises(BadRequestError, match="time_budget"):
        HandoverRequest("mug", time_budget=budget)
