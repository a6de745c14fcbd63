"""What effects see: some rows of one channel with the current model of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.redundancy import RedundantGroups
from hydrabeam_mpi.model.basis import LinearBasis
from hydrabeam_mpi.model.engine import make_engine
from hydrabeam_mpi.model.positions import SourcePositions, enu
from hydrabeam_mpi.model.rime import Beam
from hydrabeam_mpi.model.sky import Sky

EARTH_RATE = 7.292115e-5  # rad/s


@dataclass(frozen=True)
class Experiment:
    """What is known before any visibility is read, the same on every rank.

    Attributes
    ----------
    observation : Observation
        Of all channels.
    redundant : RedundantGroups
        Of the observation's baselines.
    sky : Sky
        The sky model at the observation's channels.
    basis : LinearBasis
        Of the beam.
    prior_mean : tuple of ndarray, (n_modes,)
        Fitted coefficients of each channel's model beam.
    file_pols : tuple of str
        All polarisations that the data files have.
    times : ndarray of int
        Indices of the times in use, for fitting or held out.
    """

    observation: Observation
    redundant: RedundantGroups
    sky: Sky
    basis: LinearBasis
    prior_mean: tuple[NDArray[Any], ...]
    file_pols: tuple[str, ...]
    times: IntArray

    @property
    def reference_freq(self) -> float:
        """Hz: the mean of all channels, to which laws in frequency refer."""
        return float(self.observation.freqs.mean())

    @cached_property
    def antenna_index(self) -> IntArray:
        """Indices into ``observation.antenna_numbers`` of the baselines' antennas, (Nbls, 2), in the groups' sense."""
        numbers = self.observation.antenna_numbers
        order = np.argsort(numbers)
        index = order[np.searchsorted(numbers, self.observation.antpairs, sorter=order)]
        return np.where(self.redundant.flipped[:, np.newaxis], index[:, ::-1], index)

    @cached_property
    def antennas_in_use(self) -> IntArray:
        """Indices of the antennas that have a baseline, ascending; per-antenna effects have elements for these."""
        return np.unique(self.antenna_index)


@dataclass(frozen=True)
class Sources:
    """The sources above the horizon at one time, and how the current beam sees them.

    Attributes
    ----------
    index : ndarray of int, (Nsrc,)
        Which of the sky's sources.
    za, az : ndarray, (Nsrc,)
        Radians.
    flux : ndarray, (Nsrc,)
        Jy at the scene's channel, as the sky model has them.
    beam_function : callable
        The current beam.
    latitude : float
        Radians.
    factors : dict of str to ndarray, (Nsrc,)
        What effects of each kind multiply the fluxes with.
    """

    index: IntArray
    za: FloatArray
    az: FloatArray
    flux: FloatArray
    beam_function: Beam
    latitude: float
    factors: dict[str, FloatArray] = field(default_factory=dict)

    def flux_without(self, kind: str = "") -> FloatArray:
        """Return the fluxes with the factors of all effects that change the sky but those of one kind, (Nsrc,)."""
        flux = self.flux
        for other, factor in self.factors.items():
            if other != kind:
                flux = flux * factor
        return flux

    @cached_property
    def enu(self) -> FloatArray:
        """Unit vectors, (3, Nsrc)."""
        return enu(self.za, self.az)

    @cached_property
    def beam(self) -> FloatArray:
        """Real part of the power beam, (Nsrc,)."""
        return np.asarray(self.beam_function(self.za, self.az)).real

    @cached_property
    def velocity(self) -> FloatArray:
        """How the sources' unit vectors turn with the sky, (3, Nsrc), per second."""
        axis = np.array([0.0, np.cos(self.latitude), np.sin(self.latitude)])
        # The sky turns about the celestial pole opposite to the Earth.
        return -EARTH_RATE * np.cross(axis, self.enu, axisa=0, axisb=0, axisc=0)

    @cached_property
    def slope(self) -> FloatArray:
        """Gradient of the beam on the sphere as a vector tangent to it, (3, Nsrc), per radian.

        A source displaced by a small tangent vector ``v`` has its beam changed by ``slope . v``. Central differences.
        """
        sin_za, cos_za = np.sin(self.za), np.cos(self.za)
        cos_az, sin_az = np.cos(self.az), np.sin(self.az)
        down = np.stack([cos_za * cos_az, cos_za * sin_az, -sin_za])
        around = np.stack([-sin_az, cos_az, np.zeros_like(sin_az)])
        gradient = np.zeros((3, len(self.za)))
        for direction in (down, around):
            ahead, behind = (self._beam_at(self.enu + sign * STEP * direction) for sign in (1, -1))
            gradient += direction * (ahead - behind) / (2 * STEP)
        return gradient

    def _beam_at(self, vectors: FloatArray) -> FloatArray:
        za = np.arctan2(np.hypot(vectors[0], vectors[1]), vectors[2])
        az = np.arctan2(vectors[1], vectors[0]) % (2 * np.pi)
        return np.asarray(self.beam_function(np.minimum(za, np.pi / 2), az)).real


STEP = 1e-5  # rad, of numerical derivatives of beams


@dataclass
class Scene:
    """Some rows of one channel: a rank's baselines at some times.

    Attributes
    ----------
    experiment : Experiment
    channel : int
        Index into the experiment's channels.
    times : ndarray of int, (Ntimes,)
        Indices into the observation's times.
    bls : ndarray of int, (Nbls,)
        Indices into the observation's baselines.
    groups : ndarray of int, (Ngroups,)
        The redundant groups that these belong to.
    member : ndarray of int, (Nbls,)
        Position in ``groups`` of each baseline's group.
    positions : SourcePositions
    beam : callable
        The current beam of this channel.
    engine_kind : str
        As in the job.
    weights : ndarray, (Ntimes, Nbls)
        Inverse noise variance of the calibrated data, Jy^-2; zero where there are none.
    residual : ndarray of complex, (Ntimes, Nbls)
        Calibrated data minus A b, Jy, in the sense of the groups.
    vis : ndarray of complex, (Ntimes, Nbls)
        The model A b + E of each baseline, Jy.
    integrals : dict of str to ndarray of complex, (Ntimes, Ngroups, K)
        By kind of effect; see `Effect.sky_columns`.
    places : dict, optional
        Keeps what ``positions`` says of each time, for scenes to share where there is room for it.
    sky_effects : sequence of (Effect, ndarray)
        Effects in the model that change the sky, with their parameters.
    """

    experiment: Experiment
    channel: int
    times: IntArray
    bls: IntArray
    groups: IntArray
    member: IntArray
    positions: SourcePositions
    beam: Beam
    engine_kind: str = "gemm"
    weights: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    residual: ComplexArray = field(default_factory=lambda: np.zeros((0, 0), dtype=complex))
    vis: ComplexArray = field(default_factory=lambda: np.zeros((0, 0), dtype=complex))
    integrals: dict[str, ComplexArray] = field(default_factory=dict)
    places: dict[int, tuple[IntArray, FloatArray, FloatArray]] | None = None
    sky_effects: Sequence[tuple[Any, FloatArray]] = ()
    _sources: dict[int, Sources] = field(default_factory=dict, init=False)

    @property
    def shape(self) -> tuple[int, int]:
        """(Ntimes, Nbls)."""
        return len(self.times), len(self.bls)

    @property
    def freq(self) -> float:
        """Hz."""
        return float(self.experiment.observation.freqs[self.channel])

    @property
    def ant1(self) -> IntArray:
        """Index of each baseline's first antenna in the sense of its group, (Nbls,)."""
        return self.experiment.antenna_index[self.bls, 0]

    @property
    def ant2(self) -> IntArray:
        """Index of each baseline's second antenna in the sense of its group, (Nbls,)."""
        return self.experiment.antenna_index[self.bls, 1]

    @property
    def vectors(self) -> FloatArray:
        """Baseline vectors of the groups, (Ngroups, 3), metres ENU."""
        return self.experiment.redundant.vectors[self.groups]

    def spread(self, by_group: NDArray[Any]) -> NDArray[Any]:
        """Give every baseline what its group has: (Ntimes, Ngroups, ...) to (Ntimes, Nbls, ...)."""
        return by_group[:, self.member]

    def sources(self, itime: int) -> Sources:
        """Return the sources above the horizon at an observation's time."""
        if itime in self._sources:
            return self._sources[itime]
        experiment = self.experiment
        if self.places is None:
            index, za, az = self.positions.above_horizon(itime)
        else:
            if itime not in self.places:
                self.places[itime] = self.positions.above_horizon(itime)
            index, za, az = self.places[itime]
        flux = experiment.sky.flux[self.channel, index]
        sources = Sources(index, za, az, flux, self.beam, float(experiment.observation.location.lat.rad))
        for effect, x in self.sky_effects:
            factor = effect.sky_factor(experiment, sources, x)
            sources.factors[effect.kind] = sources.factors.get(effect.kind, 1.0) * factor
        if self.places is not None:
            self._sources[itime] = sources
        return sources

    def integrate(
        self,
        columns: Callable[[Sources], FloatArray],
        vectors: FloatArray | None = None,
        flux: Literal["within columns"] | None = None,
    ) -> ComplexArray:
        """Integrate real columns over the sky at every time of the scene.

        Parameters
        ----------
        columns : callable
            From `Sources` to an array (K, Nsrc).
        vectors : ndarray, (N, 3), optional
            Baseline vectors, metres ENU; the groups' own by default.
        flux : "within columns", optional
            Where the columns hold the fluxes already.

        Returns
        -------
        ndarray of complex, (Ntimes, N, K)
            1/2 sum_s I_s column_k(s) exp(2 pi i nu b.s / c), Jy.
        """
        engine = make_engine(self.engine_kind, self.vectors if vectors is None else vectors)
        freqs = np.array([self.freq])
        out = []
        for itime in self.times.tolist():
            sources = self.sources(itime)
            weights = sources.flux_without() if flux is None else np.ones(len(sources.za))
            given = GivenColumns(columns(sources))
            design = engine.design(given, sources.za, sources.az, weights[np.newaxis], freqs)[0]
            out.append(design[0] + 1j * design[1])
        return np.array(out)

    def integrate_for(self, effects: Sequence[Any]) -> None:
        """Fill ``integrals`` for these effects in one pass over the sky."""
        if not len(self.times):
            return
        first = self.sources(int(self.times[0]))
        effects = [effect for effect in effects if effect.sky_columns(first) is not None]
        if not effects:
            return
        sizes: dict[str, int] = {}

        def columns(sources: Sources) -> FloatArray:
            parts = {one.kind: one.sky_columns(sources) * sources.flux_without(one.kind) for one in effects}
            sizes.update({kind: len(part) for kind, part in parts.items()})
            return np.concatenate(list(parts.values()))

        integrals = self.integrate(columns, flux="within columns")
        edges = np.cumsum([0, *sizes.values()])
        for kind, lo, hi in zip(sizes, edges[:-1], edges[1:], strict=True):
            self.integrals[kind] = integrals[..., lo:hi]


class GivenColumns:
    """Columns that are known already, for an engine that asks for them run by run in the order of the sources."""

    def __init__(self, values: FloatArray) -> None:
        self.values = values
        self.n_columns = len(values)
        self._next = 0

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Return the next ``len(za)`` sources' columns."""
        part = self.values[:, self._next : self._next + len(za)]
        self._next += len(za)
        if out is None:
            return part
        out[:] = part
        return out
