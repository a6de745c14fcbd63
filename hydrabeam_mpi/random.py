"""Random numbers that do not depend on who draws them.

A generator is keyed by what is drawn (seed, purpose, channel, draw, ...), never by a rank or by the order of
calls, so a run gives the same numbers on any number of ranks and a restarted run goes on as if never stopped.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray


def generator(seed: int, *key: int | str) -> np.random.Generator:
    """Return the counter-based (Philox) generator that belongs to ``seed`` and ``key``.

    Parameters
    ----------
    seed : int
        The job's seed.
    *key : int or str
        What is drawn, for instance ``("noise", channel, time)``.

    Returns
    -------
    numpy.random.Generator
        Equal keys give equal streams, different keys independent ones.
    """
    digest = hashlib.sha256(repr((int(seed), *key)).encode()).digest()
    return np.random.Generator(np.random.Philox(key=np.frombuffer(digest[:16], dtype=np.uint64)))


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.complex128]:
    """Draw circular complex Gaussian numbers with ``E|z|^2 = 1``, an array of any shape."""
    parts = rng.standard_normal((*shape, 2))
    return np.ascontiguousarray(parts).view(np.complex128)[..., 0] * np.sqrt(0.5)
