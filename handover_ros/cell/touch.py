"""Feeling the person's pull on the offered object from the robot's joint efforts."""

from __future__ import annotations

import numpy as np

from handover_ros.geometry import FloatArray


class PullDetector:
    """Compares the external force at the gripper with what it was when the object was offered.

    The baseline is the median of the first ``baseline_samples`` forces after ``reset``; it takes up the object's weight
    and the friction and model errors of this posture, so that only the change counts.

    Args:
        threshold: [N] change of force that counts as a pull.
        baseline_samples: Samples of the baseline.
    """

    def __init__(self, threshold: float, baseline_samples: int = 10) -> None:
        self.threshold = threshold
        self.baseline_samples = baseline_samples
        self._baseline: list[FloatArray] = []
        self.pull = float("nan")  # [N]

    @property
    def settled(self) -> bool:
        """Whether the baseline is known."""
        return len(self._baseline) >= self.baseline_samples

    def reset(self) -> None:
        """Forget the baseline: a new offer."""
        self._baseline = []
        self.pull = float("nan")

    def update(self, force: FloatArray) -> bool:
        """Take the external force (3,) [N] in world; return whether a pull is felt."""
        if not np.all(np.isfinite(force)):
            return False
        if not self.settled:
            self._baseline.append(np.array(force))
            return False
        self.pull = float(np.linalg.norm(force - np.median(self._baseline, axis=0)))
        return self.pull > self.threshold
