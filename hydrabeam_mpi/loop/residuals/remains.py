"""What is left in the held-out data after a fit: statistics, where it lives, and whether it is more than noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.heldout import Whitened
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P, sigma_of_log_p
from hydrabeam_mpi.loop.residuals.coherent import Coherence, CoherentRows, CoherentSums, coherences
from hydrabeam_mpi.loop.residuals.cube import Layout, Residuals, whole_baselines
from hydrabeam_mpi.loop.residuals.localise import where
from hydrabeam_mpi.loop.residuals.odd_rows import ROLES, RowPower, odd_rows
from hydrabeam_mpi.loop.residuals.statistics import statistics
from hydrabeam_mpi.loop.residuals.structures import structures
from hydrabeam_mpi.loop.residuals.sums import ResidualSums
from hydrabeam_mpi.loop.residuals.transients import TransientSums, transients
from hydrabeam_mpi.loop.residuals.whiteness import antenna_scales, is_white
from hydrabeam_mpi.mpi import together
from hydrabeam_mpi.setup.findings import Finding


@dataclass(frozen=True)
class Remains:
    """What is left.

    Attributes
    ----------
    consistent : bool
        Whether it may be noise alone.
    white : bool
        Whether it may be noise alone at another level than the data's weights say, or at other levels of antennas
        where the model has such.
    why : str
        If not, why not.
    statistics, where, structures : dict
        See the modules of these names.
    odd : tuple of Finding
        Integrations, antennas and baselines that stand out, in fitted and held-out rows alike.
    stands_out : str
        What is more than noise where chi^2 as a whole is not; empty where nothing is, or all is.
    """

    consistent: bool
    white: bool
    why: str
    statistics: dict[str, Any]
    where: dict[str, Any]
    structures: dict[str, Any] | None
    odd: tuple[Finding, ...] = ()
    stands_out: str = ""


def remains_of(context: FitContext, fitted: Fitted, whitened: Whitened) -> Remains:
    """Describe the held-out residuals. Collective: all ranks of the grid."""
    world, setup, tile = context.grid.world, context.setup, context.test.rows.tile
    layout = Layout(setup.observation, setup.redundant, context.problem.test.times)
    residuals = Residuals(whitened.z, whitened.used, context.problem.channel_numbers, tile.times, tile.bls)
    cube = whole_baselines(world, residuals, layout)
    sums = ResidualSums.of(cube).reduce(world)
    coherent, power = _all_rows(context, fitted, whitened)
    told = statistics(sums, layout, whitened.n_shared, coherent)
    own_level = sums
    if any(one.change.scales_antennas(one.x) for one in fitted.values.reweighted):
        # Scales that the fitted rows have told are not exactly those of the others.
        divided = residuals.divided(antenna_scales(sums, layout), layout)
        own_level = ResidualSums.of(whole_baselines(world, divided, layout)).reduce(world)
    white, why = is_white(own_level, layout, whitened.n_shared, coherent)
    most, consistent = told["significance"], told["significance"]["p"] >= SIGNIFICANT_P
    as_a_whole = told["overall"]["sigma"] > sigma_of_log_p(float(np.log(SIGNIFICANT_P)))
    stands_out = "" if consistent or as_a_whole else f"{most['axis']}, {most['what']} ({most['sigma']:.2g} sigma)"
    return Remains(
        consistent=consistent,
        white=white,
        why=why,
        statistics=told,
        where=where(sums, layout, whitened.n_shared, coherent),
        structures=structures(world, cube),
        odd=odd_rows(power, setup.observation),
        stands_out=stands_out,
    )


def _all_rows(context: FitContext, fitted: Fitted, whitened: Whitened) -> tuple[tuple[Coherence, ...], RowPower]:
    """Look at fitted and held-out residuals: what they have in common with the model or the sky, and their power.

    Collective: all ranks of the grid. In fitted rows the part that redundant baselines do not share is no less noise,
    as the beam has not been fitted to it, and of the rest there is less than there would be of noise.
    """
    observation, antennas = context.setup.observation, context.setup.antenna_index
    vectors = context.setup.redundant.vectors
    like_model = CoherentSums.zeros(observation.Nfreqs, observation.Nants, observation.Ntimes, observation.Nbls)
    like_sky = TransientSums.zeros(observation.Ntimes, vectors, float(observation.freqs.max()))
    power = RowPower.zeros(observation)

    def add(
        share: RankData, number: int, times: IntArray, z: ComplexArray, model: ComplexArray, root: FloatArray
    ) -> None:
        tile, member = share.rows.tile, share.rows.member
        like_model.add(number, times, z, model, CoherentRows(tile.bls, antennas[tile.bls], member))
        like_sky.add(times, z, root, vectors[share.rows.groups], member, float(observation.freqs[number]))
        power.add(ROLES.index("fitted" if share is context.train else "held out"), times, tile.bls, z)

    with together(context.grid.world):
        rows, added = context.train.calibrated(fitted.estimate)
        for channel, number in enumerate(context.channels):
            used = whitened.used[channel]
            held = (np.where(used, one[channel], 0.0) for one in (whitened.z, whitened.model, whitened.root))
            add(context.test, number, context.test.rows.tile.times, *held)
            for _, block, _ in context.train.row_blocks(channel, fitted.estimate, added[channel], rows):
                root = np.sqrt(2 * block.weights)
                add(context.train, number, block.times, root * block.residual, root * block.vis, root)
    world = context.grid.world
    coherent = (*coherences(like_model.reduce(world)), *transients(like_sky.reduce(world)))
    return coherent, power.reduce(world)
