"""Differences of postures as the limbs show them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handover_ros.arm.model import AXES, load_arm
from handover_ros.arm.turns import BALLS, rotation, turn_jacobian, turns

ARM = load_arm("adult", "right")
RNG = np.random.default_rng(4)


def test_no_turn_to_itself_and_small_ones_are_the_jacobians():
    for q in RNG.uniform(*ARM.limits, size=(20, 7)):
        change = 1e-6 * RNG.normal(size=(5, 7))
        np.testing.assert_allclose(turns(q, q[None]), 0.0, atol=1e-15)
        np.testing.assert_allclose(turns(q, q + change), change @ turn_jacobian(q).T, atol=1e-11)


def test_the_turn_carries_the_hand_over():
    """Shoulder, elbow and wrist turned by what is told end where the other posture is."""
    here, there = RNG.uniform(*ARM.limits, size=(2, 7))
    apart = turns(here, there[None])[0]
    for ball in BALLS:
        turned = rotation(here[None, ball], AXES[ball]) * Rotation.from_rotvec(apart[ball])
        np.testing.assert_allclose(turned.as_matrix(), rotation(there[None, ball], AXES[ball]).as_matrix(), atol=1e-12)
    assert apart[3] == pytest.approx(there[3] - here[3])


def test_at_a_right_angle_of_abduction_flexion_against_rotation_is_no_turn():
    raised = np.array([0.7, np.pi / 2, 0.5, 1.5, 0.3, 0.4, -0.1])
    other = raised + [-2.4, 0.0, -2.4, 0.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(turns(raised, other[None]), 0.0, atol=1e-12)
    np.testing.assert_allclose(ARM.limbs(raised), ARM.limbs(other), atol=1e-12)
