"""From what the steps cost, and how the work is shared out, to what a command takes on so many ranks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hydrabeam_mpi.config.sample import NOISE
from hydrabeam_mpi.fit.memory import fit_bytes, inference_bytes, joint_bytes, simulation_bytes
from hydrabeam_mpi.fit.room import Room
from hydrabeam_mpi.io.posterior_file import MAP_PIXELS
from hydrabeam_mpi.loop.checks.conventions import N_TIMES
from hydrabeam_mpi.loop.memory import Candidates, candidates_of, further_bytes, weighing_bytes
from hydrabeam_mpi.loop.selection.known_beforehand import known_kinds
from hydrabeam_mpi.planning.files import Files
from hydrabeam_mpi.planning.measure import Bench
from hydrabeam_mpi.planning.network import Network
from hydrabeam_mpi.planning.outline import Outline
from hydrabeam_mpi.planning.programs import Taken, done
from hydrabeam_mpi.planning.search import SearchBench
from hydrabeam_mpi.planning.shares import Shares, Simulated, memory_of
from hydrabeam_mpi.planning.told import Forecast
from hydrabeam_mpi.result.output import least_result_bytes

ON_DISK = 21
"""Bytes of a visibility in a file: complex, a flag, nsamples in single precision."""
STEPS_A_ROUND = 12
"""Sums over ranks of a round: all effects weighed, and some fits of four steps, of rivals and what is refused too."""

CHOICES = 2
"""How often it is chosen what a loop looks for: before its rows are read, to know whether there is room, and after."""


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
    programs : dict of str to Taken
        What each command loads besides.
    found : int
        Effects that a loop finds: an assumption.
    """

    bench: Bench
    files: Files
    network: Network
    startup_s: float
    base_bytes: int
    programs: dict[str, Taken]
    found: int = 1
    _shares: dict[int, Shares] = field(default_factory=dict)
    _searches: dict[Room, SearchBench] = field(default_factory=dict)

    def forecast(self, command: str, ranks: int) -> Forecast:
        """Return what a command takes on so many ranks."""
        n_shared = self._sharing(command, ranks)
        shares = self._shares.setdefault(n_shared, Shares(self.bench.outline, n_shared))
        steps = Steps(self, shares, ranks)
        is_loop = command == "loop"
        own = self.base_bytes + self.programs[command].n_bytes
        return Forecast(
            command,
            ranks,
            {name: seconds for name, seconds in steps.phases(command).items() if seconds > 0},
            max(own + steps.memory(command), self.bench.outline.peak_bytes),
            steps.sent(command),
            steps.written(command),
            Simulated(self.bench.outline, ranks).partition if command == "simulate" else shares.partition,
            memory_of(ranks),
            steps.round_s if is_loop else 0.0,
            further_bytes(self.candidates, shares.share) if is_loop else 0,
            steps.anew_s if is_loop else 0.0,
        )

    @property
    def candidates(self) -> Candidates:
        """What a loop weighs, in all channels."""
        return self._chosen[0]

    @property
    def choosing(self) -> Taken:
        """What it takes to choose that."""
        return self._chosen[1]

    @cached_property
    def _chosen(self) -> tuple[Candidates, Taken]:
        observation, one = self.bench.outline.observation, self.bench.outline.problem
        n = observation.Nfreqs
        # Of the beam of one channel, as which those of the others are taken.
        numbers = np.repeat(one.channel_numbers, n)
        whole = replace(one, observation=observation, priors=n * one.priors, channel_numbers=numbers)
        return done(lambda: candidates_of(whole), self.bench.clock)

    def search(self, room: Room) -> SearchBench:
        """Return what the parts of a loop cost where so much is kept."""
        return self._searches.setdefault(room, SearchBench(self.bench, room))

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
        known = {"start": self.model.startup_s + self.model.programs[command].seconds, "simulate": self._simulate()}
        if command == "simulate":
            return known
        known |= {"prepare": self._prepare(), "health": self._health(), "read": self._read()}
        further = {"infer": self._infer, "loop": self._loop, "sample": self._sample}[command]
        return known | further()

    def _simulate(self) -> float:
        if not self.simulates:
            return 0.0
        outline, cost = self.outline, self.model.bench.simulated
        n_groups = outline.problem.redundant.Ngroups + 1
        seen = Simulated(outline, self.ranks).slowest * (cost.by_time + cost.by_group * n_groups)
        files = self.model.files
        fixed, each = files.write
        scene = outline.prepare_s - outline.n_channels * outline.fit_s
        return scene + outline.n_channels * seen + files.first_s + fixed + each * self.n_simulated

    def _prepare(self) -> float:
        """Seconds on rank 0, for which all wait."""
        outline = self.outline
        return outline.scene_s + outline.n_channels * outline.fit_s if self.simulates else outline.prepare_s

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

    @property
    def _triangle(self) -> int:
        """Bytes of a sum of products of the coefficients' columns, of which one triangle is sent."""
        return self.shares.share.matrix // 2

    def _allreduce(self, n_bytes: int) -> float:
        return self.model.network.allreduce(n_bytes, self.shares.in_group)

    def _infer(self) -> dict[str, float]:
        bench, shares, matrix = self.model.bench, self.shares, self.shares.share.matrix
        sums = self._allreduce(self._triangle) + self.model.network.message(matrix)
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

    @property
    def _search(self) -> SearchBench:
        share = self.shares.share
        return self.model.search(share.room(share.train_times))

    def _loop(self) -> dict[str, float]:
        search, shares, found = self._search, self.shares, self.model.found
        return {
            "choose": CHOICES * self.model.choosing.seconds,
            "conventions": shares.seconds(search.conventions, most=N_TIMES),
            "fit": shares.seconds(search.fit),
            "attribution": shares.seconds(search.attribution) + self._sums(1),
            "prior": shares.seconds(search.prior),
            "rounds": found * self.round_s,
            "settle": shares.seconds(search.end)
            + (self.model.bench.together.fit_s if self.model.bench.together else 0),
            **self._write(),
        }

    @property
    def anew_s(self) -> float:
        """Seconds in which all effects are weighed once more; see `Forecast`."""
        job = self.outline.job
        may_begin_anew = known_kinds(job) or (self.outline.n_channels == 1 and job.prior.widths != "stated")
        return self.shares.seconds(self._search.attribution) if may_begin_anew else 0.0

    @property
    def round_s(self) -> float:
        """Seconds of an effect that a loop finds: it is fitted beside its rivals, and all are weighed again."""
        steps = STEPS_A_ROUND - 1
        together = steps * self._together() + self._together_again()
        search = self._search
        own = search.longer * self.shares.seconds(search.attribution) + search.fits * self.shares.seconds(search.fit)
        return own + self._sums(STEPS_A_ROUND) + together

    def _together_again(self) -> float:
        """Seconds of a fit with effects on rank 0, where channels hang together."""
        known = self.model.bench.together
        return known.fit_s if known else 0.0

    def _sums(self, n: int) -> float:
        """Seconds of ``n`` sums over ranks of matrices of the coefficients' size."""
        several = self.shares.in_group > 1
        return several * self.shares.channels * n * self._allreduce(self._triangle)

    def _sample(self) -> dict[str, float]:
        bench, shares, settings = self.model.bench, self.shares, self.outline.job.sample
        chains = -(-settings.chains // min(self.ranks, settings.chains))
        one = shares.seconds(bench.draw) + (self._allreduce(self._triangle) if shares.in_group > 1 else 0.0)
        return {
            "begin": shares.seconds(bench.begin_chains) + (bench.together.fit_s if bench.together else 0.0),
            "draws": chains * (settings.warm_up + settings.draws) * one,
            "together": chains * (settings.warm_up + settings.draws) * self._factorised(),
        }

    def memory(self, command: str) -> int:
        """Return the bytes of the rank that needs most, besides the problem and the programs."""
        before = simulation_bytes(self.n_simulated // self.outline.n_channels, self.outline.n_channels)
        if command == "simulate":
            return before
        share, is_joint = self.shares.share, command == "sample" or self.outline.job.effects
        if command == "loop":
            needed = fit_bytes(share, True, weighing_bytes(self.model.candidates, share))
            before = max(before, self.model.choosing.n_bytes)
        else:
            needed = (joint_bytes if is_joint else inference_bytes)(share, True)
        return max(before, needed + self._gathered())

    def _gathered(self) -> int:
        """Return the bytes of what rank 0 gathers of channels, but for covariances."""
        share, outline = self.shares.share, self.outline
        numbers = outline.job.output.draws * share.basis.n_modes + 7 * MAP_PIXELS
        return outline.n_channels * numbers * share.item

    def sent(self, command: str) -> int:
        """Return the bytes that a rank sends, the root of a group most."""
        share, p = self.shares.share, self.shares.in_group
        one_sum = 2 * share.channels * self._triangle * (p - 1) // p
        to_group = share.channels * share.matrix * (p > 1)
        result = least_result_bytes(self.outline.job, share.channels) if self.shares.n_groups > 1 else 0
        found = self.model.found
        settings = self.outline.job.sample
        chains = -(-settings.chains // min(self.ranks, settings.chains))
        return {
            "simulate": 16 * self.n_simulated // self.ranks if self.ranks > 1 else 0,
            "infer": one_sum + to_group + result,
            "loop": (1 + STEPS_A_ROUND * found) * (one_sum + to_group) + result,
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
