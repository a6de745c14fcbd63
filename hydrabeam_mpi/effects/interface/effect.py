"""What every effect must be able to do: its parameters, its change of the model, and the derivative of that change.

The data are modelled as

    d = C (A b + E) + n

with A b the visibilities that the beam sees, E what an effect adds and C what it multiplies each visibility with; all
but b are functions of the effects' real parameters x. Effects that add are summed, each as it is where antennas and
sources are by those that move them, which do so one after the other; effects that multiply are multiplied, and effects
that change the sky change A. Everything that follows works on the calibrated data d/C - E with weights w|C|^2, in which
the derivative of the model is dE/dx, d ln C/dx (A b + E) or dA/dx b: the *columns* of the effect.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.changing import MayChange
from hydrabeam_mpi.effects.interface.in_beam import InBeam
from hydrabeam_mpi.effects.interface.limits import HasLimits
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.other_data import InOtherData
from hydrabeam_mpi.effects.interface.parameters import Parameters as Parameters
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.skies_on_rings import SkiesOnRings
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.model.positions import SourcePositions


@dataclass(frozen=True)
class Columns:
    """Derivatives of the model visibilities by an effect's parameters, for the rows of a block.

    Attributes
    ----------
    values : ndarray of complex, (Ntimes, Nrows, k)
        The k derivatives of a row that are not zero. A row is a baseline, or with ``by_group`` a redundant group.
    index : ndarray of int, broadcastable to (Ntimes, Nrows, k), optional
        The parameters they belong to; one that occurs twice in a row counts with the sum. Without it k = n_params.
    n_params : int
    by_group : bool
        Whether rows are the block's groups (for effects that redundant baselines share) rather than its baselines.
    """

    values: ComplexArray
    n_params: int
    index: IntArray | None = None
    by_group: bool = False

    def matrix(self) -> Any:
        """Return the columns as a matrix, (Ntimes x Nrows, n_params): sparse, or dense where there is no index."""
        n_rows = self.values.shape[0] * self.values.shape[1]
        if self.index is None:
            return self.values.reshape(n_rows, self.n_params)
        k = self.values.shape[2]
        index = np.broadcast_to(self.index, self.values.shape).reshape(-1)
        # A copy, as adding up duplicates sorts in place.
        parts = (self.values.reshape(-1).copy(), index.copy(), np.arange(0, n_rows * k + 1, k))
        matrix = csr_array(parts, (n_rows, self.n_params))
        matrix.sum_duplicates()
        return matrix

    def of_rows(self, member: IntArray) -> Columns:
        """Return the same of each baseline, which belong to the groups ``member``, (Nbls,)."""
        if not self.by_group:
            return self
        index = self.index
        if index is not None and index.ndim > 1 and index.shape[-2] > 1:
            index = index[..., member, :]
        return Columns(self.values[:, member], self.n_params, index)

    def apply(self, x: FloatArray) -> ComplexArray:
        """Return the change of the model for a small ``x``, (Ntimes, Nrows)."""
        return np.asarray(self.matrix() @ x).reshape(self.values.shape[:2])


class Cause(ABC):
    """Something that the instrument or the sky may do and that the model lacks: what it is called, and its parameters.

    A plain picklable object without data.
    """

    kind: str
    """Name in job files and in ``loop.json``."""
    title: str
    """Name in sentences."""
    law: str = "constant"
    """How its parameters go on in time; see `effects.shared.in_time`."""
    shared: bool = False
    """Whether all channels have the same parameters, through a law in frequency."""

    @property
    def special_case(self) -> tuple[str, str] | None:
        """Kind and law of what this is where nothing changes in time; None where nothing does anyway."""
        return None if self.law == Cause.law else (self.kind, Cause.law)

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Say why these data cannot show the effect, and which could; None where they can."""
        return None

    @abstractmethod
    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the parameters."""

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return combinations of parameters that no data can tell from another beam, (n, n_params).

        They are held at zero where all of their parameters are free.
        """
        return np.zeros((0, len(self.parameters(setup))))

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw parameters to simulate with, of rms ``strength`` x scale, (n_params,)."""
        parameters = self.parameters(setup)
        return strength * parameters.scale * rng.standard_normal(len(parameters))

    def drawn(self, setup: ObservingSetup, rng: np.random.Generator) -> Cause:
        """Return the cause to simulate: itself, or where there are candidates, one of them at random."""
        return self

    def describe(self) -> dict[str, Any]:
        """Return what, besides its kind, makes this effect: keyword arguments of its class, JSON-able."""
        return {}


class Effect(InBeam, InOtherData, HasLimits, MayChange, Cause):
    """A cause that changes what the rows of the job's polarisation are expected to be.

    It sees the data through a `RowBlock`, some rows of one channel. All that depends on ``x`` is for one channel's
    parameters, whether or not they are shared between channels.
    """

    multiplies: bool = False
    """Whether the effect multiplies (C) rather than adds (E)."""
    has_gains: bool = True
    """Whether what it multiplies with are gains of antennas whatever the beam is, see `gains`."""
    sees_beam: bool = False
    """Whether what it multiplies with depends on the current beam, as what effects add may."""
    changes_sky: bool = False
    """Whether the effect changes the sky (see `sky_factor`, `extra_sky`), by which it is part of A rather than of E."""
    moves_antennas: bool = False
    """Whether the effect is that antennas are elsewhere, where all others then see the sky; see `displacements`."""
    displaces_sky: bool = False
    """Whether the effect is that sources are elsewhere, where all others then see them; see `displaced`."""
    linear: bool = False
    """Whether the data are so nearly linear in the parameters that a fit gains about what the linear model predicts."""
    comes_in_parts: ClassVar[bool] = False
    """Whether the model may get more and more of it, one part after the other; see `next_after`."""
    is_control_model: ClassVar[bool] = False
    """Whether it is a control model: effects must explain the data better, and it is never claimed itself."""

    @property
    def is_by_group(self) -> bool:
        """Whether the baselines of a group all see the effect alike, and every one of them sees it."""
        return self.changes_sky or self.of_the_sky or self.is_about_the_beam or self.is_control_model

    @property
    def gets_simpler_when_fitted(self) -> bool:
        """Whether a fit may need fewer elements than the search did, once places or delays are refined."""
        return False

    def sky_columns(self, sources: Sources) -> FloatArray | None:
        """Return what the effect needs integrated over the sky at one time, (K, Nsrc) real.

        `RowBlock.integral` then has, (Ntimes, Ngroups, K) complex,

            1/2 sum_s I_s column_k(s) exp(2 pi i nu b_g.s / c)

        for every group g. The beam must be part of the columns. The fluxes I_s are those with all effects that change
        the sky but this one.
        """
        return None

    @property
    def integrated_as(self) -> str:
        """The name of what it needs integrated over the sky, which is the same for all effects of this name."""
        return self.kind

    def sky_factor(self, setup: ObservingSetup, sources: Sources, x: FloatArray) -> FloatArray | None:
        """Return what multiplies each source's flux, (Nsrc,), for effects that change those of the sky; else None."""
        return None

    def extra_sky(self, block: RowBlock, itime: int, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Return further sources at one time, za, az (radians) and flux (Jy), for effects that change the sky.

        Each is (Nsrc,).
        """
        return None

    def standing_numbers(self, block: RowBlock, itime: int, x: FloatArray) -> FloatArray | None:
        """Return of which combination of skies that do not turn `extra_sky` is one time's, (K,); None if of none."""
        return None

    def standing_skies(self, block: RowBlock) -> SkiesOnRings | None:
        """Return these skies; None if there are none."""
        return None

    def displacements(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return by how much each of the observation's antennas is elsewhere, (Nants, 3), metres ENU.

        See `moves_antennas`; ``x`` is (n_params,).
        """
        return np.zeros_like(setup.observation.antpos)

    def displaced(self, block: RowBlock, x: FloatArray) -> SourcePositions:
        """Return where the effect has the sources at a block's times, of which that says where they are without it.

        See `displaces_sky`; ``x`` is (n_params,).
        """
        return block.positions

    def slopes(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the columns at ``x`` in a block where the effect has displaced the sky, if it does so."""
        return self.columns(block, x)

    @abstractmethod
    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return dE/dx, or d ln C/dx (A b + E), at the parameters ``x``, (n_params,)."""

    def begun(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return where a fit begins, given the parameters with which the columns at zero fit best, (..., n_params)."""
        return x

    def needed_at(self, setup: ObservingSetup, x: FloatArray) -> tuple[Effect, IntArray, BoolArray]:
        """Return the effect with all that a fit needs which begins as `begun` says, with the columns' ``x`` at zero.

        A gain whose sign is lost has a phase of pi, of which columns at zero say nothing, so that none was looked for.
        With it come the numbers of the effect's own parameters in it, (n_params,), and which others are needed,
        (n_all,).
        """
        n = x.shape[-1]
        return self, np.arange(n), np.zeros(n, dtype=bool)

    def beside_model(
        self, setup: ObservingSetup, overlap: ComplexArray, model: FloatArray
    ) -> tuple[FloatArray, ComplexArray] | None:
        """Return what makes up best for what visibilities m of the model beam leave of the data; None if that is not C.

        Parameters
        ----------
        setup : ObservingSetup
        overlap, model : ndarray, (Nfreqs, Nbls)
            Sums over time of w d m* and of w |m|^2.

        Returns
        -------
        x : ndarray, (Nfreqs, n_params)
            Parameters, as columns at zero would have them; see `begun`.
        factor : ndarray of complex, (Nfreqs, Nbls)
            C with these.
        """
        return None

    def without_turns(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the parameters nearest to zero of the same C, (..., n_params): phases without whole turns."""
        return x

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return E at ``x``, (Ntimes, Nbls); zero for effects that multiply. Exact, not linearised."""
        if self.multiplies:
            return np.zeros(block.shape, dtype=complex)
        columns = self.columns(block, x)
        change = columns.apply(x)
        return block.spread(change) if columns.by_group else change

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return C at ``x``, (Ntimes, Nbls); one for effects that add."""
        return np.ones(block.shape, dtype=complex)

    def gains(self, setup: ObservingSetup, channel: int, x: FloatArray) -> ComplexArray:
        """Return the gains g of all antennas in a channel, with C = g_j g_k*.

        They are (Nants,), or where they change in time (Ntimes, Nants) with all times of the observation; one for
        effects that add, and where there are none (`has_gains`).
        """
        return np.ones(setup.observation.Nants, dtype=complex)

    def gains_seen(self, block: RowBlock, x: FloatArray) -> ComplexArray | None:
        """Return the gains of the observation's antennas at a block's times, (Ntimes, Nants), with C = g_j g_k*.

        Those that depend on the block's beam are among them. None where no gains of antennas stand for what it
        multiplies with.
        """
        if not self.has_gains:
            return None
        gains = self.gains(block.setup, block.channel, x)
        return gains[block.times] if gains.ndim > 1 else np.broadcast_to(gains, (len(block.times), len(gains)))

    def refined(self, x: FloatArray, used: IntArray) -> tuple[Effect, FloatArray, IntArray]:
        """Return the effect as described by what has been fitted, such as sources where they are and no others.

        Of its parameters at ``x``, (Nfreqs, n_params), those that are left, with all that are ``used``, (n_used,), come
        with it: their values, (Nfreqs, n_left), and their numbers before, ascending, (n_left,).
        """
        return self, x, np.arange(x.shape[1])

    def unchanging(self, n_params: int) -> tuple[Effect, IntArray] | None:
        """Return what it is if it does not change in time, and which of the ``n_params`` parameters are then left.

        Their numbers are (n_left,). None where what is constant is no part of it.
        """
        return None

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return elements that may be something with fewer parameters: which are theirs, (n_params,), and that effect.

        With the values, (n,), where that begins. ``x`` and ``std``, (Nfreqs, n_params), are what has been fitted, and
        its standard deviations.
        """
        return []

    def price_of_motion(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> float:
        """Return the nats that it costs to tell how it moves from all ways that it might; zero for what stays.

        Arguments are as of `simpler_elements`.
        """
        return 0.0

    def told(self, setup: ObservingSetup, x: FloatArray, std: FloatArray) -> Told:
        """Return fitted parameters and their errors, (Nfreqs, n_params) each, as they are told: one for each."""
        parameters = self.parameters(setup)
        return Told(parameters.names, parameters.units, x, std, np.ones(len(parameters), dtype=bool))

    def in_full(self, setup: ObservingSetup) -> Effect:
        """Return the effect with what its settings leave to the data, such as the times that a law is over."""
        return self

    def sought_in(self, setup: ObservingSetup) -> Effect:
        """Return the effect as it is looked for in data, with what of it depends on which data these are."""
        return self

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return what to look for where ``newest`` is the last effect that the model got.

        That is this effect itself, or where it has a successor and ``newest`` is of its kind, the one after that.
        """
        return self

    def variants(self, setup: ObservingSetup) -> list[Effect]:
        """Return other forms of the effect with the same parameters, of which the fit tells which is the likeliest."""
        return []

    def same_in_all_channels(self) -> Effect | None:
        """Return the effect with one set of parameters for all channels; None where that is no form of it."""
        return None

    def alike(self, setup: ObservingSetup, x: FloatArray, element: int) -> Iterable[Effect]:
        """Return the effect with one of its elements at other places where data see nearly the same of it.

        ``x``, (Nfreqs, n_params), is what has been fitted. The likeliest by what is known beforehand come first.
        """
        return ()

    def larger(self, setup: ObservingSetup) -> Sequence[Effect]:
        """Return the effect with more parameters of its sort, where it may need them all at once.

        Each has those of the one before it first.
        """
        return ()
