"""A folder of chains: what they are of, and their draws.

``chains.json`` says what all chains of the folder are of (see `ChainStore`), ``chain-0`` and so on hold their segments
(see `hydrabeam_mpi.sampling.storage.segment`). What is whole can be read at any moment, also while the chains grow.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.disk import writing
from hydrabeam_mpi.io.reading import read_json, reading
from hydrabeam_mpi.sampling.storage.chain_files import ChainFiles, retried
from hydrabeam_mpi.sampling.storage.identity import check_same
from hydrabeam_mpi.sampling.storage.segment import FORMAT, last_state
from hydrabeam_mpi.sampling.storage.variable import Variable
from hydrabeam_mpi.sampling.storage.whole_file import write_file
from hydrabeam_mpi.sampling.storage.writer import ChainWriter

CHAINS = "chains.json"
REMEDY = "name a folder that 'hydrabeam sample' wrote"


@dataclass
class ChainStore:
    """A folder of chains.

    Attributes
    ----------
    folder : Path
    identity : dict
        What a job must have in common with the chains to go on with them: tables of JSON.
    variables : tuple of Variable
    chains, draws, warm_up : int
        How many chains are wanted, and how many draws of each after its first ``warm_up`` ones, which are stored, too.
    about : dict
        What else there is to know, such as the job and the versions.
    """

    folder: Path
    identity: dict[str, Any]
    variables: tuple[Variable, ...]
    chains: int
    draws: int
    warm_up: int
    about: dict[str, Any]
    _files: dict[int, ChainFiles] = field(default_factory=dict, repr=False)

    @staticmethod
    def exists(folder: Path) -> bool:
        """Whether a folder has chains."""
        return (folder / CHAINS).exists()

    @classmethod
    def create(
        cls,
        folder: Path,
        identity: Mapping[str, Any],
        variables: Sequence[Variable],
        chains: int,
        draws: int,
        warm_up: int = 0,
        about: Mapping[str, Any] | None = None,
    ) -> ChainStore:
        """Begin a folder of chains.

        Raises
        ------
        InputError
            If it has chains already, or cannot be written.
        """
        if cls.exists(folder):
            raise InputError("has chains already", file=folder, field="-o", remedy="name another folder")
        store = cls(folder, _as_json(identity), tuple(variables), chains, draws, warm_up, _as_json(about or {}))
        with writing(folder / CHAINS):
            folder.mkdir(parents=True, exist_ok=True)
        store._write()
        return store

    @classmethod
    def open(cls, folder: Path, identity: Mapping[str, Any] | None = None) -> ChainStore:
        """Open a folder of chains, to read them or, with the job's ``identity``, to go on with them.

        Raises
        ------
        InputError
            If it has none, or they are of another job: names what differs.
        """
        path = folder / CHAINS
        table = read_json(path, what="a description of chains", remedy=REMEDY)
        if table.get("format") != FORMAT:
            told = f"is of format {table.get('format')!r}, and not {FORMAT}"
            raise InputError(told, file=path, remedy="read it with the version that wrote it")
        with reading(path, "a description of chains", remedy=REMEDY):
            variables = tuple(Variable.from_table(one) for one in table["variables"])
            chains, draws, warm_up = (int(table[key]) for key in ("chains", "draws", "warm_up"))
            store = cls(folder, dict(table["identity"]), variables, chains, draws, warm_up, dict(table["about"]))
        if identity is not None:
            check_same(store.identity, _as_json(identity), path)
        return store

    @property
    def total(self) -> int:
        """Draws that are wanted of each chain, warm-up included."""
        return self.warm_up + self.draws

    def extend(self, chains: int, draws: int) -> None:
        """Want another number of chains and of draws.

        Raises
        ------
        InputError
            If that cannot be written.
        """
        if (chains, draws) != (self.chains, self.draws):
            self.chains, self.draws = chains, draws
            self._write()

    def variable(self, name: str) -> Variable:
        """Return the variable of a name.

        Raises
        ------
        InputError
            If there is none.
        """
        for variable in self.variables:
            if variable.name == name:
                return variable
        known = ", ".join(variable.name for variable in self.variables)
        raise InputError(f"no variable {name!r}", file=self.folder, remedy=f"choose one of {known}")

    def files(self, chain: int) -> ChainFiles:
        """Return the files of a chain."""
        return self._files.setdefault(chain, ChainFiles(self.folder / f"chain-{chain}", chain))

    def writer(self, chain: int) -> ChainWriter:
        """Return what appends to a chain, after the draws that are whole.

        Raises
        ------
        InputError
            If another process writes that chain, or the folder cannot be written.
        """
        return ChainWriter(self.files(chain), self.variables)

    def n_draws(self, chain: int) -> int:
        """Return how many draws of a chain are whole, warm-up included."""
        segments = self.files(chain).segments()
        return segments[-1].end if segments else 0

    def comparable(self) -> tuple[tuple[int, ...], slice]:
        """Choose chains that can be compared: those at least half as long as the longest, cut to a common length.

        Returns
        -------
        chains : tuple of int
        draws : slice
            For `read`, after the warm-up.
        """
        lengths = {chain: max(0, self.n_draws(chain) - self.warm_up) for chain in range(self.chains)}
        longest = max(lengths.values(), default=0)
        chains = tuple(chain for chain, n in lengths.items() if n and 2 * n >= longest)
        common = min((lengths[chain] for chain in chains), default=0)
        return chains, slice(self.warm_up, self.warm_up + common)

    def info_names(self, chain: int) -> list[str]:
        """Name the numbers that there are about every draw; none before the first."""

        def read() -> list[str]:
            for segment in self.files(chain).segments()[:1]:
                with segment.open() as file:
                    return list(file["info"])
            return []

        return retried(read)

    def last(self, chain: int) -> tuple[int, dict[str, Array]]:
        """Return how many draws of a chain are whole, and its state after the last of them; none before the first."""

        def read() -> tuple[int, dict[str, Array]]:
            segments = self.files(chain).segments()
            return (segments[-1].end, last_state(segments[-1])) if segments else (0, {})

        return retried(read)

    def read(self, name: str, chain: int, draws: slice | None = None, index: slice | None = None) -> Array:
        """Read a variable.

        Parameters
        ----------
        name : str
        chain : int
        draws : slice, optional
            Which ones, counted from the first one of the warm-up; all after the warm-up by default.
        index : slice, optional
            Which numbers of the flattened array; no others are read.

        Returns
        -------
        ndarray
            (n, and the axes of the variable); with ``index`` (n, number of them).
        """
        variable = self.variable(name)
        found = self._read(f"draws/{name}", chain, draws, index if index is not None else slice(None))
        return found if index is not None else found.reshape(len(found), *variable.shape)

    def info(self, name: str, chain: int, draws: slice | None = None) -> FloatArray:
        """Read a number about every draw, such as "seconds"."""
        return self._read(f"info/{name}", chain, draws)

    def _read(self, place: str, chain: int, draws: slice | None, *index: slice) -> Array:
        wanted = slice(self.warm_up, None) if draws is None else draws

        def read() -> Array:
            segments = self.files(chain).segments()
            first, end, step = wanted.indices(segments[-1].end if segments else 0)
            assert step == 1, "draws are read without gaps"
            parts = []
            for one in segments:
                begin, until = max(first, one.first), min(end, one.end)
                if begin < until:
                    with one.open() as file:
                        parts.append(file[place][(slice(begin - one.first, until - one.first), *index)])
            return np.concatenate(parts) if parts else self._nothing(place, index)

        return retried(read)

    def _nothing(self, place: str, index: Sequence[slice]) -> Array:
        """Return an array of no draws."""
        group, name = place.split("/")
        if group == "info":
            return np.empty(0)
        variable = self.variable(name)
        return np.empty((0, variable.size), dtype=variable.dtype)[(slice(None), *index)]

    def cautions(self) -> list[str]:
        """Say what is damaged, a line for each chain."""
        said = (self.files(chain).caution() for chain in range(self.chains))
        return [line for line in said if line]

    def _write(self) -> None:
        table = {
            "format": FORMAT,
            "chains": self.chains,
            "draws": self.draws,
            "warm_up": self.warm_up,
            "identity": self.identity,
            "variables": [variable.to_table() for variable in self.variables],
            "about": self.about,
        }
        with writing(self.folder / CHAINS):
            write_file(self.folder / CHAINS, (json.dumps(table, indent=1) + "\n").encode())


def _as_json(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table as it is once it has been written and read."""
    return dict(json.loads(json.dumps(table)))
