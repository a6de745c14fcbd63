"""The largest structures of whitened residuals: singular vectors over baselines and over times x frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.inference.significance import LARGEST
from hydrabeam_mpi.loop.residuals.cube import Cube, Layout
from hydrabeam_mpi.mpi import Comm, allreduce_max, allreduce_sum
from hydrabeam_mpi.random import complex_normal, generator

N_VECTORS = 10
N_ITERATIONS = 12
MOST = 3
MOST_LISTED = 32
LARGEST_PATTERN = 64  # times and channels that a pattern is averaged down to
TRACY_WIDOM = (-1.7711, 0.9018)  # mean and standard deviation, complex matrices
SMALLEST_SIGMA = 4.0


@dataclass(frozen=True)
class Decomposition:
    """The largest singular values of the baselines x (frequencies, times) matrix of z.

    Attributes
    ----------
    values : ndarray, (k,)
        Descending.
    patterns : ndarray of complex, (k, Nfreqs, Nt)
        Unit right singular vectors, conjugated: z = sum_k value_k left_k pattern_k.
    by_baseline : ndarray, (k, Nbls)
        |left_k|^2.
    power : float
        Sum of |z|^2.
    n : int
        Number of visibilities.
    """

    values: FloatArray
    patterns: ComplexArray
    by_baseline: FloatArray
    power: float
    n: int


def decompose(comm: Comm, cube: Cube) -> Decomposition:
    """Find the largest singular values by subspace iteration. Collective: all ranks of `comm`.

    Needs no more memory than the cube again and a few vectors, whatever the size of the matrix. The values of
    structures that stand out from the noise converge; those within it come out a little small.
    """
    n_freqs, n_times, n_bls = cube.layout.shape
    z = cube.z.reshape(n_freqs * n_times, len(cube.bls)).T
    used = ~np.isnan(z.real)
    z = np.where(used, z, np.complex64(0))
    totals = np.array([np.sum(np.abs(z).astype(float) ** 2), used.sum()])
    allreduce_sum(comm, totals)
    # Of a model that is far off, cubes of the residuals would be beyond single precision.
    largest = np.abs(z).max(initial=0.0, keepdims=True).astype(float)
    allreduce_max(comm, largest)
    # A power of two, by which nothing is rounded.
    scale = float(2 ** np.ceil(np.log2(max(largest.max(), 1.0))))
    z = z / np.float32(scale)
    k = min(N_VECTORS, n_freqs * n_times, n_bls)
    basis = np.linalg.qr(complex_normal(generator(0, "structures"), (n_freqs * n_times, k)))[0]
    for _ in range(N_ITERATIONS):
        image = z.conj().T @ (z @ basis.astype(np.complex64))
        image = np.ascontiguousarray(image, dtype=complex)
        allreduce_sum(comm, image)
        basis = np.linalg.qr(image)[0]
    left = z @ basis.astype(np.complex64)
    gram = np.ascontiguousarray(left.conj().T @ left, dtype=complex)
    allreduce_sum(comm, gram)
    squares, mixing = eigen(gram)
    order = np.argsort(-squares)
    values = np.sqrt(np.maximum(squares[order], 0.0))
    by_baseline = np.zeros((k, n_bls))
    by_baseline[:, cube.bls] = (np.abs(left @ mixing[:, order]) ** 2).T / np.maximum(values[:, np.newaxis] ** 2, 1e-300)
    allreduce_sum(comm, by_baseline)
    patterns = (basis @ mixing[:, order]).conj().T.reshape(k, n_freqs, n_times)
    return Decomposition(scale * values, patterns, by_baseline, float(totals[0]), round(float(totals[1])))


def noise_edge(n_rows: int, n_columns: int, filled_fraction: float) -> tuple[float, float]:
    """Return the mean and the standard deviation of the largest singular value of whitened noise.

    The edge of the Marchenko-Pastur distribution with the Tracy-Widom law about it, for E|z|^2 = 2.

    Parameters
    ----------
    n_rows, n_columns : int
    filled_fraction : float
        Fraction of the matrix that is not zero; taken as spread evenly.
    """
    root = np.sqrt(n_rows) + np.sqrt(n_columns)
    width = root * (1 / np.sqrt(n_rows) + 1 / np.sqrt(n_columns)) ** (1 / 3)
    square = 2 * filled_fraction * (root**2 + TRACY_WIDOM[0] * width)
    spread = 2 * filled_fraction * TRACY_WIDOM[1] * width
    value = np.sqrt(max(square, 1e-300))
    return float(value), float(spread / (2 * value))


def structures(comm: Comm, cube: Cube) -> dict[str, Any] | None:
    """Describe the largest structures, JSON-able and of bounded size. Collective: all ranks of `comm`.

    Returns
    -------
    dict or None
        None without residuals. ``singular_values``: the largest ten; ``edge``: the largest that noise would have, of
        unit variance and of the residuals' own, each {"mean", "std"}. ``structures``: up to three that stand out from
        noise of unit variance by four standard deviations, the first in any case, each with ``singular_value``,
        ``sigma``, ``share`` of the sum of |z|^2, ``baselines`` and ``antennas`` (up to 32, the strongest first,
        {"what", "share"}), and ``pattern``: {"freqs_hz", "jds", "lsts_h", "real", "imag"} over frequency and time,
        averaged to 64 channels and times at most, the phase such that its largest element is positive.
    """
    found = decompose(comm, cube)
    n_freqs, n_times, _ = cube.layout.shape
    rows_used = int(np.sum(np.any(found.by_baseline > 0, axis=0)))
    if not found.n or not rows_used:
        return None
    fraction = found.n / (rows_used * n_freqs * n_times)
    mean, spread = noise_edge(rows_used, n_freqs * n_times, fraction)
    rms = np.sqrt(found.power / (2 * found.n))
    sigmas = np.clip((found.values - mean) / spread, -LARGEST, LARGEST)
    shown = [k for k in range(min(MOST, len(sigmas))) if k == 0 or sigmas[k] > SMALLEST_SIGMA]
    return {
        "singular_values": found.values.tolist(),
        "edge": {
            "expected_noise": {"mean": mean, "std": spread},
            "noise_of_this_rms": {"mean": float(mean * rms), "std": float(spread * rms)},
        },
        "structures": [_describe(found, k, float(sigmas[k]), cube.layout) for k in shown],
    }


def _describe(found: Decomposition, k: int, sigma: float, layout: Layout) -> dict[str, Any]:
    observation, share = layout.observation, found.by_baseline[k]
    antennas = sum(np.bincount(one, share, observation.Nants) for one in layout.observation.antenna_index.T) / 2
    return {
        "singular_value": float(found.values[k]),
        "sigma": sigma,
        "share": float(found.values[k] ** 2 / found.power) if found.power else 0.0,
        "baselines": _strongest(observation.antpairs.tolist(), share),
        "antennas": _strongest(observation.antenna_numbers.tolist(), np.asarray(antennas)),
        "pattern": _pattern(found.patterns[k], layout),
    }


def _strongest(what: list[Any], share: FloatArray) -> list[dict[str, Any]]:
    order = np.argsort(-share, kind="stable")[:MOST_LISTED]
    return [{"what": what[i], "share": float(f"{share[i]:.4g}")} for i in order.tolist() if share[i] > 0]


def _pattern(pattern: ComplexArray, layout: Layout) -> dict[str, Any]:
    observation = layout.observation
    n_freqs, n_times = pattern.shape
    freqs = np.array_split(np.arange(n_freqs), min(n_freqs, LARGEST_PATTERN))
    times = np.array_split(np.arange(n_times), min(n_times, LARGEST_PATTERN))
    averaged = np.array([[pattern[np.ix_(f, t)].mean() for t in times] for f in freqs])
    largest = averaged.ravel()[np.argmax(np.abs(averaged))]
    averaged = averaged * (abs(largest) / largest if largest else 1.0)
    middle = [layout.times[part[len(part) // 2]] for part in times]
    return {
        "freqs_hz": [float(observation.freqs[f].mean()) for f in freqs],
        "jds": observation.times[middle].tolist(),
        "lsts_h": np.round(observation.lst_hours[middle], 4).tolist(),
        "real": [[float(f"{value:.4g}") for value in row] for row in averaged.real],
        "imag": [[float(f"{value:.4g}") for value in row] for row in averaged.imag],
    }
