"""From what the steps cost, and how the work is shared out, to what a command takes on so many ranks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hydrabeam_mpi.config.sample import NOISE
from hydrabeam_mpi.data.partition import make_tiles
from hydrabeam_mpi.fit.memory import inference_bytes, loop_bytes, simulation_bytes
from hydrabeam_mpi.io.posterior_file import MAP_PIXELS
from hydrabeam_mpi.planning.files import Files
from hydrabeam_mpi.planning.measure import Bench
from hydrabeam_mpi.planning.network import Network
from hydrabeam_mpi.planning.outline import Outline
from hydrabeam_mpi.planning.shares import Partition, Shares
from hydrabeam_mpi.result.output import least_result_bytes

ON_DISK = 21
"""Bytes of a visibility in a file: complex, a flag, nsamples in single precision."""
FITS_BESIDES = 2
"""Effects fitted in a loop besides those that are found: rivals, and what is refused."""


@dataclass(frozen=True)
class Forecast:
    """What a command takes.

    Attributes
    ----------
    command : str
    ranks : int
    phases_s : dict of str to float
        Seconds by phase.
    memory_bytes, sent_bytes : int
        Of the rank that needs, or sends, most.
    file_bytes : int
        Of what is written, simulated data included.
    partition : Partition
    """

    command: str
    ranks: int
    phases_s: dict[str, float]
    memory_bytes: int
    sent_bytes: int
    file_bytes: int
    partition: Partition

    @property
    def wall_s(self) -> float:
        """Seconds from start to end."""
        return sum(self.phases_s.values())


@dataclass
class Model:
    """What the steps cost, and on how many rows.

    Attributes
    ----------
    bench : Bench
    files : Files
    network : Network
    startup_s : float
        Until a process has imported what it needs.
    base_bytes : int
        Memory of a process before its own share.
    found : int
        Effects that a loop finds: an assumption.
    """

    bench: Bench
    files: Files
    network: Network
    startup_s: float
    base_bytes: int
    found: int = 1
    _shares: dict[int, Shares] = field(default_factory=dict)

    def forecast(self, command: str, ranks: int) -> Forecast:
        """Return what a command takes on so many ranks."""
        n_shared = self._sharing(command, ranks)
        shares = self._shares.setdefault(n_shared, Shares(self.bench.outline, n_shared))
        steps = Steps(self, shares, ranks)
        return Forecast(
            command,
            ranks,
            {name: seconds for name, seconds in steps.phases(command).items() if seconds > 0},
            self.base_bytes + steps.memory(command),
            steps.sent(command),
            steps.written(command),
            shares.partition,
        )

    def _sharing(self, command: str, ranks: int) -> int:
        """Return how many ranks share the rows: those of a chain, where chains are drawn."""
        return max(ranks // self.bench.outline.job.sample.chains, 1) if command == "sample" else ranks


@dataclass(frozen=True)
class Steps:
    """The steps of a command on a number of ranks."""

    model: Model
    shares: Shares
    ranks: int

    @property
    def outline(self) -> Outline:
        """The job."""
        return self.model.bench.outline

    @property
    def simulates(self) -> bool:
        """Whether the job's data are simulated."""
        return self.outline.job.data.simulate is not None

    @property
    def n_simulated(self) -> int:
        """Number of simulated visibilities, autocorrelations included."""
        at = self.outline.observation
        return at.Nfreqs * at.Ntimes * (at.Nbls + at.Nants) if self.simulates else 0

    def phases(self, command: str) -> dict[str, float]:
        """Return the seconds of each phase."""
        known = {"start": self.model.startup_s, "simulate": self._simulate()}
        if command == "simulate":
            return known
        known |= {"prepare": self._prepare(), "health": self._health(), "read": self._read()}
        further = {"infer": self._infer, "loop": self._loop, "sample": self._sample}[command]
        return known | further()

    def _simulate(self) -> float:
        if not self.simulates:
            return 0.0
        outline, bench = self.outline, self.model.bench
        costs = outline.relative_costs
        n_times = min(self.ranks, len(costs))
        parts = make_tiles(np.arange(len(costs)), costs, np.zeros(1, int), np.zeros(1, int), n_times)
        cost, n_groups = bench.simulated, outline.problem.redundant.Ngroups + 1
        seen = max(outline.times_of(part) for part in parts) * (cost.by_time + cost.by_group * n_groups)
        files = self.model.files
        fixed, each = files.write
        scene = outline.prepare_s - outline.fit_s + (outline.n_channels - 1) * outline.scene_s
        return scene + outline.n_channels * seen + files.first_s + fixed + each * self.n_simulated

    def _prepare(self) -> float:
        """Seconds on rank 0, for which all wait."""
        outline = self.outline
        first = outline.scene_s + outline.fit_s if self.simulates else outline.prepare_s
        return first + (outline.n_channels - 1) * (outline.scene_s + outline.fit_s)

    def _rows(self) -> int:
        """Return the visibilities of a rank."""
        share = self.shares.share
        return share.channels * (share.train_times + share.test_times) * share.baselines

    def _read(self) -> float:
        fixed, each = self.model.files.read
        return fixed + each * self._rows()

    def _health(self) -> float:
        fixed, each = self.model.files.health
        cost, tiles = self.model.bench.simulated, (self.shares.seconds(self.model.bench.simulated),)
        return fixed + each * self._rows() + sum(tiles) + self.shares.seconds(cost, test=True)

    def _allreduce(self, n_bytes: int) -> float:
        return self.model.network.allreduce(n_bytes, self.shares.in_group)

    def _infer(self) -> dict[str, float]:
        bench, shares, matrix = self.model.bench, self.shares, self.shares.share.matrix
        sums = self._allreduce(matrix) + self.model.network.message(matrix)
        return {
            "design": shares.seconds(bench.design),
            "sum": shares.channels * sums if shares.in_group > 1 else 0.0,
            "solve": shares.channels * bench.solve_s,
            "together": self._together() + (bench.together.inference_s if bench.together else 0.0),
            "heldout": shares.seconds(bench.heldout, test=True),
            **self._write(),
        }

    def _together(self) -> float:
        """Seconds in which rank 0 is told of all channels that hang together."""
        if self.model.bench.together is None:
            return 0.0
        elsewhere = 1 - 1 / self.shares.n_groups
        return self.model.network.beta * elsewhere * self.outline.n_channels * self.shares.share.matrix

    def _factorised(self) -> float:
        """Seconds of the beams of one draw, which are solved for as effects move and again as the noise does."""
        known, settings = self.model.bench.together, self.outline.job.sample
        n_solved = settings.thin * (1 + (NOISE in settings.blocks))
        return n_solved * (self._together() + known.factor_s) if known else 0.0

    def _write(self) -> dict[str, float]:
        """Seconds of describing channels, of sending them to rank 0, and of writing them there."""
        _, each = self.model.files.write
        bench, outline = self.model.bench, self.outline
        size = least_result_bytes(outline.job, outline.n_channels)
        elsewhere = 1 - 1 / self.shares.n_groups
        return {
            "describe": self.shares.channels * bench.describe_s,
            "gather": self.model.network.beta * size * elsewhere,
            "write": bench.write_s + each * size / ON_DISK,
        }

    def _loop(self) -> dict[str, float]:
        bench, shares, found = self.model.bench, self.shares, self.model.found
        matrix = shares.share.matrix
        weighings, fits = found + 1, found + FITS_BESIDES
        in_group = shares.in_group > 1
        return {
            "conventions": 2 * shares.seconds(bench.simulated),
            "fit": shares.seconds(bench.fit),
            "attribution": weighings * shares.seconds(bench.attribution),
            "trials": fits * shares.seconds(bench.trial),
            "sum": in_group * shares.channels * (weighings + 4 * fits) * self._allreduce(matrix),
            "together": 4 * fits * self._together() + (fits + 1) * (bench.together.fit_s if bench.together else 0.0),
            "settle": shares.seconds(bench.trial),
            **self._write(),
        }

    def _sample(self) -> dict[str, float]:
        bench, shares, settings = self.model.bench, self.shares, self.outline.job.sample
        chains = -(-settings.chains // min(self.ranks, settings.chains))
        one = shares.seconds(bench.draw) + (self._allreduce(shares.share.matrix) if shares.in_group > 1 else 0.0)
        return {
            "begin": shares.seconds(bench.begin_chains) + (bench.together.fit_s if bench.together else 0.0),
            "draws": chains * (settings.warm_up + settings.draws) * one,
            "together": chains * (settings.warm_up + settings.draws) * self._factorised(),
        }

    def memory(self, command: str) -> int:
        """Return the bytes of the rank that needs most, besides the problem and the programs."""
        simulating = simulation_bytes(self.n_simulated // self.outline.n_channels, self.outline.n_channels)
        if command == "simulate":
            return simulating
        n_bytes = inference_bytes if command == "infer" and not self.outline.job.effects else loop_bytes
        return max(simulating, n_bytes(self.shares.share, root=True) + self._gathered())

    def _gathered(self) -> int:
        """Return the bytes of what rank 0 gathers of channels, but for covariances."""
        share, outline = self.shares.share, self.outline
        numbers = outline.job.output.draws * share.basis.n_modes + 7 * MAP_PIXELS
        return outline.n_channels * numbers * share.item

    def sent(self, command: str) -> int:
        """Return the bytes that a rank sends, the root of a group most."""
        share, p = self.shares.share, self.shares.in_group
        one_sum = 2 * share.channels * share.matrix * (p - 1) // p
        to_group = share.channels * share.matrix * (p > 1)
        result = least_result_bytes(self.outline.job, share.channels) if self.shares.n_groups > 1 else 0
        found = self.model.found
        settings = self.outline.job.sample
        chains = -(-settings.chains // min(self.ranks, settings.chains))
        return {
            "simulate": 16 * self.n_simulated // self.ranks if self.ranks > 1 else 0,
            "infer": one_sum + to_group + result,
            "loop": (1 + found + 4 * (found + FITS_BESIDES)) * (one_sum + to_group) + result,
            "sample": chains * (settings.warm_up + settings.draws) * one_sum,
        }[command]

    def written(self, command: str) -> int:
        """Return the bytes of what is written."""
        simulated = ON_DISK * self.n_simulated
        if command == "simulate":
            return simulated
        outline, settings = self.outline, self.outline.job.sample
        if command == "sample":
            share = self.shares.share
            return settings.chains * settings.draws * outline.n_channels * share.basis.n_modes * share.item
        return least_result_bytes(outline.job, outline.n_channels)
