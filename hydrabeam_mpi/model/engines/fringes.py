"""Fringes exp(+2 pi i nu b.s/c) of many sources on many baselines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.model.engines.antenna_pairs import AntennaPairs, find_pairs
from hydrabeam_mpi.model.engines.phasors import fill_phasors
from hydrabeam_mpi.model.engines.smearing import Smearing


@dataclass(frozen=True)
class Lattice:
    """Vectors as integer combinations of two generators: ``vectors = index @ generators``."""

    generators: FloatArray  # (2, 3) metres
    index: IntArray  # (Nvectors, 2)


def find_lattice(vectors: FloatArray, tol: float) -> Lattice | None:
    """Find the plane lattice on which all vectors, (Nvectors, 3), lie within ``tol`` metres, if there is one.

    The two shortest vectors that are not parallel are tried as generators, which is what a filled array has;
    the generators are then fitted to all vectors.
    """
    lengths = np.linalg.norm(vectors, axis=1)
    order = np.argsort(lengths)
    order = order[lengths[order] > tol]
    if len(order) < 3:
        return None
    first = vectors[order[0]]
    sine = np.linalg.norm(np.cross(first, vectors[order]), axis=1) / (lengths[order[0]] * lengths[order])
    turned = np.flatnonzero(sine > 0.1)
    if not len(turned):
        return None
    generators = np.stack([first, vectors[order[turned[0]]]])
    index = np.rint(vectors @ np.linalg.pinv(generators)).astype(np.int64)
    if np.abs(index).max() > 1000:
        return None
    generators = np.linalg.lstsq(index.astype(float), vectors, rcond=None)[0].astype(float)
    if np.linalg.norm(index @ generators - vectors, axis=1).max() > tol:
        return None
    return Lattice(generators, index)


def enu(za: FloatArray, az: FloatArray) -> FloatArray:
    """Return the unit vectors towards (za, az), (3, N): east, north, up."""
    sin_za = np.sin(za)
    return np.stack([sin_za * np.cos(az), sin_za * np.sin(az), np.cos(za)])


def plane_waves(vectors: FloatArray, directions: FloatArray, freq: float) -> ComplexArray:
    """Return exp(+2 pi i freq b.s/c) of every vector and source.

    Parameters
    ----------
    vectors : ndarray, (Nvectors, 3)
        Metres ENU.
    directions : ndarray, (3, Nsrc)
        Unit vectors towards the sources, ENU.
    freq : float
        Hz.

    Returns
    -------
    ndarray of complex, (Nvectors, Nsrc)
    """
    turns = (freq / C_M_PER_S * vectors) @ directions
    waves = np.empty(turns.shape, dtype=complex)
    fill_phasors(turns, waves.real, waves.imag)
    return waves


class Fringes:
    """The fringes of a fixed set of baseline vectors.

    On a lattice a fringe is the product of two geometric sequences, which costs two complex exponentials a
    source instead of one a source and vector. Elsewhere it is the product of the phases of two antennas, one
    exponential an antenna, as far as vectors are differences of antennas' places.

    Parameters
    ----------
    vectors : ndarray, (Nvectors, 3)
        Metres ENU.
    tol : float
        Distance in metres within which vectors count as lying on a lattice.
    points : ndarray, (Npoints, 3)
        Where antennas stand, metres ENU.
    smearing : Smearing, optional
        Over what the fringes are means.
    """

    def __init__(
        self,
        vectors: FloatArray,
        tol: float = 1e-7,
        points: FloatArray | None = None,
        smearing: Smearing | None = None,
    ) -> None:
        self.vectors = np.ascontiguousarray(vectors, dtype=float)
        self.lattice = find_lattice(self.vectors, tol)
        self.pairs = find_pairs(self.vectors, points) if points is not None and self.lattice is None else None
        self.smearing = smearing

    def fill(self, out: FloatArray, directions: FloatArray, weights: FloatArray, freq: float) -> None:
        """Write ``weights_s exp(+2 pi i freq b.s/c)`` into ``out``.

        Parameters
        ----------
        out : ndarray, (2, Nvectors, Nsrc)
            Receives the real parts, then the imaginary parts, in double or in single precision. Phases, which are
            large, are always formed in double.
        directions : ndarray, (3, Nsrc)
            Unit vectors towards the sources, ENU.
        weights : ndarray, (Nsrc,)
            Real weight of each source.
        freq : float
            Hz.
        """
        self._fill_sharp(out, directions, weights, freq)
        if self.smearing is not None:
            out *= self.smearing.left(self.vectors, directions, freq).astype(out.dtype, copy=False)

    def correlate(self, values: ComplexArray, directions: FloatArray, freq: float) -> FloatArray:
        """Return Re sum_u conj(fringe_u) V_u for every source, (Nsrc,).

        Where fringes are products of two factors the sum is one over each of these, one of which is a matrix product.

        Parameters
        ----------
        values : ndarray of complex, (Nvectors,)
            V.
        directions, freq
            As for `fill`.
        """
        if self.smearing is not None or (self.lattice is None and self.pairs is None):
            return self._correlate_each(values, directions, freq)
        if self.pairs is not None:
            pairs, waves = self.pairs, plane_waves(self.pairs.points, directions, freq)
            by_points = np.zeros((len(waves), len(waves)), dtype=complex)
            np.add.at(by_points, (pairs.second, pairs.first), values[pairs.rows])
            found = np.einsum("ps,ps->s", waves.conj(), by_points @ waves).real
            rest = plane_waves(self.vectors[pairs.rest], directions, freq)
            return np.asarray(found + (values[pairs.rest].conj() @ rest).real)
        assert self.lattice is not None
        steps = plane_waves(self.lattice.generators, directions, freq)
        along, across = (dict(_powers(step, index)) for step, index in zip(steps, self.lattice.index.T, strict=True))
        rows, columns = ({n: number for number, n in enumerate(powers)} for powers in (along, across))
        on_lattice = np.zeros((len(rows), len(columns)), dtype=complex)
        places = [(rows[i], columns[j]) for i, j in self.lattice.index.tolist()]
        np.add.at(on_lattice, tuple(np.transpose(places)), values.conj())
        summed = on_lattice @ np.array(list(across.values()))
        return np.asarray(np.einsum("ps,ps->s", np.array(list(along.values())), summed).real)

    def _correlate_each(self, values: ComplexArray, directions: FloatArray, freq: float) -> FloatArray:
        """Do as `correlate` by the fringe of each vector."""
        rows = np.empty((2, len(self.vectors), directions.shape[1]))
        self.fill(rows, directions, np.ones(directions.shape[1]), freq)
        parts = np.concatenate([values.real, values.imag])
        return np.asarray(parts @ rows.reshape(len(parts), -1))

    def _fill_sharp(self, out: FloatArray, directions: FloatArray, weights: FloatArray, freq: float) -> None:
        """Do as `fill` for one instant and frequency."""
        if self.pairs is not None:
            self._fill_pairs(self.pairs, out, directions, weights, freq)
            return
        if self.lattice is None:
            fill_phasors((freq / C_M_PER_S * self.vectors) @ directions, out[0], out[1])
            out *= weights.astype(out.dtype, copy=False)
            return
        steps = plane_waves(self.lattice.generators, directions, freq)
        dtype = np.result_type(out.dtype, np.complex64)
        along = {n: (weights * power).astype(dtype) for n, power in _powers(steps[0], self.lattice.index[:, 0])}
        across = {n: power.astype(dtype) for n, power in _powers(steps[1], self.lattice.index[:, 1])}
        product = np.empty(len(weights), dtype)
        for row, (i, j) in enumerate(self.lattice.index.tolist()):
            np.multiply(along[i], across[j], out=product)
            out[0, row] = product.real
            out[1, row] = product.imag

    def _fill_pairs(
        self, pairs: AntennaPairs, out: FloatArray, directions: FloatArray, weights: FloatArray, freq: float
    ) -> None:
        """Do as `_fill_sharp` by the phases of antennas, and by exponentials for what is no difference of theirs."""
        rest = weights * plane_waves(self.vectors[pairs.rest], directions, freq)
        out[0, pairs.rest], out[1, pairs.rest] = rest.real, rest.imag
        waves = plane_waves(pairs.points, directions, freq)
        weighted = weights * waves.conj()
        product = np.empty_like(waves[0])
        for row, one, two in zip(pairs.rows.tolist(), pairs.first.tolist(), pairs.second.tolist(), strict=True):
            np.multiply(weighted[one], waves[two], out=product)
            out[0, row] = product.real
            out[1, row] = product.imag


def _powers(base: ComplexArray, exponents: IntArray) -> Iterator[tuple[int, ComplexArray]]:
    """Yield the powers of unit complex numbers that ``exponents`` asks for, by repeated multiplication."""
    asked = set(exponents.tolist())
    power = np.ones_like(base)
    for n in range(max(map(abs, asked), default=0) + 1):
        if n in asked:
            yield n, power
        if n and -n in asked:
            yield -n, power.conj()
        power = power * base
