"""Random numbers that depend on what they are for, never on the order in which things are worked on."""

from __future__ import annotations

import zlib

import numpy as np


def generator(seed: int, name: str, number: int = 0) -> np.random.Generator:
    """Return the generator of one named thing of a study."""
    return np.random.default_rng(np.random.SeedSequence((seed, zlib.crc32(name.encode()), number)))
