"""Random numbers that depend on what they are for, never on the order in which things are worked on."""

from __future__ import annotations

import zlib

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.preferences.space import PreferenceSpace


def generator(seed: int, name: str, number: int = 0) -> np.random.Generator:
    """Return the generator of one named thing of a study."""
    return np.random.default_rng(np.random.SeedSequence((seed, zlib.crc32(name.encode()), number)))


def anybody(space: PreferenceSpace, rng: np.random.Generator) -> FloatArray:
    """Return a random preference in a space's coordinates (p,), even over its bounds as the first belief is."""
    lower, upper = space.bounds
    return np.asarray(lower + rng.random(len(lower)) * (upper - lower))
