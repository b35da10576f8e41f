"""The dynamics between two frames are the exact solution of their differential equation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from handover_ros.skeleton.dynamics_model import linear_dynamics

memories = st.one_of(st.just(float("inf")), st.floats(0.05, 20.0))


def by_van_loan(elapsed, order, memory):
    """Return F and Q from one matrix exponential (Van Loan 1978)."""
    a = np.diag(np.ones(order - 1), 1) - np.diag([0.0, *(1.0 / m for m in memory[: order - 1])])
    block = np.zeros((2 * order, 2 * order))
    block[:order, :order], block[order:, order:] = -a, a.T
    block[order - 1, 2 * order - 1] = 1.0
    solution = expm(elapsed * block)
    transition = solution[order:, order:].T
    return transition, transition @ solution[:order, order:]


@settings(deadline=None)
@given(st.floats(0.001, 0.25), st.sampled_from([2, 3]), memories, memories)
def test_equals_the_matrix_exponential(elapsed, order, rate_memory, acceleration_memory):
    """For equal and for infinite time constants, too, where closed forms would divide by zero."""
    transition, noise = linear_dynamics(elapsed, order, rate_memory, acceleration_memory)
    expected_transition, expected_noise = by_van_loan(elapsed, order, (rate_memory, acceleration_memory))
    np.testing.assert_allclose(transition, expected_transition, rtol=1e-11, atol=1e-14)
    # Relative to what each entry is at most.
    scale = np.sqrt(np.outer(np.diag(expected_noise), np.diag(expected_noise)))
    np.testing.assert_allclose(noise / scale, expected_noise / scale, atol=1e-8)


@pytest.mark.parametrize("order", [2, 3])
def test_without_fading_they_are_the_textbooks(order):
    """Bar-Shalom, Li, Kirubarajan 2001, section 6.2."""
    t = 0.02
    transition, noise = linear_dynamics(t, order)
    np.testing.assert_allclose(transition[0], [1.0, t, t * t / 2.0][:order], rtol=1e-14)
    textbook = {
        2: [[t**3 / 3.0, t**2 / 2.0], [t**2 / 2.0, t]],
        3: [
            [t**5 / 20.0, t**4 / 8.0, t**3 / 6.0],
            [t**4 / 8.0, t**3 / 3.0, t**2 / 2.0],
            [t**3 / 6.0, t**2 / 2.0, t],
        ],
    }
    np.testing.assert_allclose(noise, textbook[order], rtol=1e-12)


def test_two_steps_are_one_of_twice_the_length():
    for order in (2, 3):
        transition, noise = linear_dynamics(0.01, order, 0.5, 0.25)
        twice, twice_noise = linear_dynamics(0.02, order, 0.5, 0.25)
        np.testing.assert_allclose(transition @ transition, twice, rtol=1e-12, atol=1e-16)
        np.testing.assert_allclose(transition @ noise @ transition.T + noise, twice_noise, rtol=1e-9)
