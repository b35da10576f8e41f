"""What very many small menus would tell: every choice among few of the same items, as in pairwise comparisons."""

from __future__ import annotations

from typing import Any

import numpy as np

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.preferences import menu_kernels
from handover_ros.preferences.query import IntArray
from handover_ros.preferences.space import People
from handover_ros.threads import in_parts

kernels: Any = menu_kernels  # numba's functions carry no types
LEAST_PART = 100_000  # choices of persons for which another thread pays


def information_of_menus(people: People, weights: FloatArray, items: FloatArray, menus: IntArray) -> FloatArray:
    """Return the mutual information of person and choice of each menu [nat], shape (m,).

    Args:
        people: Believed persons.
        weights: Of each, sum 1, shape (n,).
        items: Configurations [rad] that menus are made of, of equal measure, shape (items, d).
        menus: Places of each menu's items, shape (m, k).

    Raises:
        BadRequestError: A menu is empty or names an item that is not there.
    """
    if menus.ndim != 2 or not menus.size or menus.min() < 0 or menus.max() >= len(items):
        raise BadRequestError(f"menus: need places below {len(items)}, shape (menus, items of each), got {menus.shape}")
    # C = w q^2 - 2 w q* q + constant; the constant cancels in every choice.
    costs = people.weights @ np.square(items).T - 2.0 * (people.weights * people.neutral) @ items.T
    exponents = np.ascontiguousarray(-(people.rationality[:, None] * costs).T)
    result = np.empty(len(menus))

    def part(start: int, end: int) -> None:
        kernels.information_of_menus(exponents, weights, menus[start:end], result[start:end])

    in_parts(len(menus), part, max(1, LEAST_PART // (len(people) * menus.shape[1])))
    return np.maximum(result, 0.0)
