"""Polarisation leakage: each feed of an antenna picks up part of the other one's signal, e_i + d^e_i n_i.

It is seen in cross-polarised visibilities. To first order, of a sky that is not polarised,

    V_en,ij = d^e_i V_nn,ij + conj(d^n_j) V_ee,ij.

The regressors are the measured co-polarised visibilities of the same baseline and time. They need no beam of the other
feed, hold for any sky, and their own leakage is of second order. Their noise makes the D-terms too small by the ratio
of noise to power in them (``attenuation``), which is little where co-polarised data can tell a beam. Where V_ee and
V_nn are nearly proportional, a common d^e_i + c with d^n_j - c* is hardly decided, and the prior keeps it small.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.cross_polarised import CrossPolarised
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import FEEDS, ObservingSetup


class Leakage(CrossPolarised):
    """D-terms of all antennas and both feeds, constant in time, each channel its own.

    Not an `Effect`, as its rows are of other polarisations than those from which the beam is inferred.
    """

    kind = "leakage"
    title = "polarisation leakage"

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Say which polarisations the files lack; None where all that are needed are there."""
        if self.feeds(setup) is not None:
            return None
        return (
            "leakage is seen in cross-polarised visibilities, with both co-polarised ones beside them (ee, nn and en); "
            f"the files have {', '.join(setup.file_pols)}"
        )

    def feeds(self, setup: ObservingSetup) -> tuple[str, str] | None:
        """Return the names of the two feeds."""
        have = set(setup.file_pols)
        for one, other in FEEDS:
            if {2 * one, 2 * other} <= have and have & {one + other, other + one}:
                return one, other
        return None

    def copols(self, setup: ObservingSetup) -> tuple[str, str]:
        """Return the co-polarisations, that of the first feed first."""
        feeds = self.feeds(setup)
        assert feeds is not None
        return 2 * feeds[0], 2 * feeds[1]

    def cross_pols(self, setup: ObservingSetup) -> tuple[str, ...]:
        """Return the cross-polarisations that the files have."""
        feeds = self.feeds(setup)
        return tuple(pol for pol in setup.file_pols if feeds and set(pol) == set(feeds))

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return real and imaginary part of every antenna's D-terms, those of the first feed first."""
        feeds = self.feeds(setup)
        assert feeds is not None
        antennas = setup.observation.antenna_numbers[setup.antennas_in_use]
        names = [
            f"antenna {number} feed {feed} leakage, {part} part"
            for number in antennas
            for feed in feeds
            for part in ("real", "imaginary")
        ]
        return Parameters.of(names, "", 0.05, np.arange(len(names)) // 2)

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return what all antennas have in common, c in d_e + c and d_n - c*, (2, n_params).

        The sky being unpolarised, that shows by the difference of the feeds' beams alone.
        """
        n_ants = len(setup.antennas_in_use)
        return np.stack([np.tile([1.0, 0.0, -1.0, 0.0], n_ants), np.tile([0.0, 1.0, 0.0, 1.0], n_ants)])

    def columns(self, setup: ObservingSetup, pol: str, bls: IntArray, copols: Mapping[str, ComplexArray]) -> Columns:
        """Return the derivatives of cross-polarised visibilities by the D-terms.

        Parameters
        ----------
        setup : ObservingSetup
        pol : str
            Such as "en".
        bls : ndarray of int, (Nbls,)
            Indices into the observation's baselines.
        copols : mapping of str to ndarray of complex, (Ntimes, Nbls)
            Measured visibilities such as of "ee" and "nn", Jy, in the sense of the observation's antpairs.
        """
        feeds = self.feeds(setup)
        assert feeds is not None
        first, second = _stored_antennas(setup, bls)
        mine, theirs = (4 * ant + 2 * feeds.index(feed) for ant, feed in zip((first, second), pol, strict=True))
        by_first, by_second = copols[2 * pol[1]], copols[2 * pol[0]]
        values = np.stack([by_first, 1j * by_first, by_second, -1j * by_second], axis=-1)
        return Columns(
            values,
            4 * len(setup.antennas_in_use),
            np.stack([mine, mine + 1, theirs, theirs + 1], axis=-1),
        )

    def without(
        self, setup: ObservingSetup, bls: IntArray, copols: Mapping[str, ComplexArray], x: FloatArray
    ) -> dict[str, ComplexArray]:
        """Return co-polarised visibilities as they were before the leakage, for an unpolarised sky.

        With ee' = ee + d_e1 d_e2* nn and nn' = nn + d_n1 d_n2* ee, where a prime is for what is measured.

        Parameters
        ----------
        setup, bls, copols
            As for `columns`.
        x : ndarray, (n_params,)
            D-terms.
        """
        into_one, into_other = self._from_copols(setup, bls, x)
        one, other = self.copols(setup)
        scale = 1 / (1 - into_one * into_other)
        return {
            one: scale * (copols[one] - into_one * copols[other]),
            other: scale * (copols[other] - into_other * copols[one]),
        }

    def measured(
        self, setup: ObservingSetup, copols: Mapping[str, ComplexArray], x: FloatArray
    ) -> dict[str, ComplexArray]:
        """Return what is measured in the co-polarisations and in the cross-polarisations that the files have.

        By polarisation, each (Ntimes, Nbls) at one channel, with ``x`` (n_params,).
        """
        bls = np.arange(setup.observation.Nbls)
        into_one, into_other = self._from_copols(setup, bls, x)
        one, other = self.copols(setup)
        cross = {pol: self.columns(setup, pol, bls, copols).apply(x) for pol in self.cross_pols(setup)}
        return {
            one: copols[one] + into_one * copols[other],
            other: copols[other] + into_other * copols[one],
        } | cross

    def _from_copols(self, setup: ObservingSetup, bls: IntArray, x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return d_1 d_2* of either feed, the parts of the other one's visibilities that are added to its own."""
        first, second = _stored_antennas(setup, bls)
        terms = x.reshape(-1, 2, 2) @ np.array([1, 1j])
        into_one, into_other = (terms[first, feed] * terms[second, feed].conj() for feed in (0, 1))
        return into_one, into_other


def _stored_antennas(setup: ObservingSetup, bls: IntArray) -> IntArray:
    """Return the first and the second antenna of baselines as stored, among those in use, (2, Nbls)."""
    index = setup.antenna_index[bls]
    stored = np.where(setup.redundant.flipped[bls, np.newaxis], index[:, ::-1], index)
    return np.searchsorted(setup.antennas_in_use, stored).T
