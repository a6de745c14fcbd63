"""What is to be inferred from what: the one argument of `infer` and `close_loop`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, Unpack

from hydrabeam_mpi.api.arguments import Tables, arguments_named, job_of
from hydrabeam_mpi.config import Job, Section
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.setup.given import NOTHING, Given

if TYPE_CHECKING:
    from hydrabeam_mpi.mpi import Comm


class Setup:
    """Data, sky, model beam and choices of one inference.

    The model of a visibility between antennas j and k is

        V_jk(nu, t) = 1/2 sum_s I_s(nu) B(s, nu) exp(2 pi i nu b_jk.s / c),        B = sum_n b_n f_n,

    linear in the coefficients b (HDBI II, eqs 2 to 9).

    With a communicator of several ranks all of them make the Setup together. What rank 0 has counts, and the others
    may pass None: of data in memory each rank gets its own rows from there, as it reads them out of files. From then on
    an exception that nothing catches on one rank ends all of them, after a `sys.excepthook` of the caller's own.

    Parameters
    ----------
    uvd : UVData, str, Path or a sequence of them
        The visibilities: in memory, or names of files, of several times, channels or polarisations. Flags and
        nsamples count; phased data are turned back to drift scan in a copy. Of several polarisations
        ``data={"polarization": "nn"}`` chooses; "ee" is the default, and `infer` takes a list of them.
    beam : UVBeam, BeamInterface, analytic beam of pyuvdata, str, Path or mapping, optional
        The model beam, whose fit in the basis is the prior mean; names as in a job file, the built-in HERA beam at
        131 MHz by default. ``beam_options={"frequency": "interpolate"}`` and others are as in a job.
    sky : SkyModel, str, Path or mapping, optional
        The sky, a mock by default. ``sky_options`` are the other keys of ``[sky]``.
    prior : mapping, str, Path, Result, Prior or a sequence of these, optional
        As in a job, such as ``{"fraction": 0.03}``, or one for all channels or one for each. A result (or its folder)
        of other data, such as `load` gives: what these have told of the beam and of effects that carry over is known.
    basis : FourierBessel, Zernike or mapping, optional
        That of a result which is the prior by default.
    comm : mpi4py.MPI.Comm, optional
        This process alone by default.
    noise : array_like, str, Path or mapping, optional
        Variances E|n|^2 of the visibilities in Jy^2, in a shape that broadcasts to that of ``uvd.data_array``,
        (Nblts, Nfreqs, Npols); or the keys of the table ``[noise]`` of a job: ``kind`` ("autocorrelations", which is
        the default, "constant", "file", "time-differences" or "frequency-differences"), with ``sigma`` (Jy, root of
        E|n|^2) of a constant one, and ``file``, whose name alone will do.
    holdout : mapping, optional
        The keys of the table ``[holdout]``: ``kind`` ("times", "lst", "jd", "baselines" or "none"), with ``every`` (the
        last of every so many times), ``lst_ranges`` (h), ``jd_ranges`` (days) or ``antpairs`` (numbers of antennas).
        ``{"kind": "times", "every": 2}`` by default.
    **tables
        ``data``, ``solver``, ``output``, ``loop``, ``sample``: the keys of these tables of a job. ``name``, ``seed``.

    Attributes
    ----------
    job : Job
        The same as a job file has it.
    given : Given
        What is in memory; on rank 0.
    path : Path or None
        The job file.

    Raises
    ------
    InputError
        On all ranks, if an argument cannot be used; its ``field`` names the argument.
    """

    def __init__(
        self,
        uvd: Any,
        *,
        beam: Any = None,
        sky: Any = None,
        prior: Any = None,
        basis: Section | Mapping[str, Any] | None = None,
        comm: Comm | None = None,
        **tables: Unpack[Tables],
    ) -> None:
        arguments = {"uvd": uvd, "beam": beam, "sky": sky, "prior": prior, "basis": basis}
        made: tuple[Job, Given] | None = None
        _end_together(comm)
        with _together(comm), arguments_named():
            if comm is None or comm.rank == 0:
                made = job_of(arguments, tables)
        job, self.given = made or (None, NOTHING)
        shared: Any = comm.bcast(job) if comm is not None else job
        self.job: Job = shared
        self.path: Path | None = None
        self._comm = comm

    @classmethod
    def from_job(cls, path: str | Path, comm: Comm | None = None) -> Self:
        """Return what a job file describes. Collective: all ranks of ``comm``.

        Raises
        ------
        InputError
            On all ranks, if the job cannot be used.
        """
        from hydrabeam_mpi.mpi import alone
        from hydrabeam_mpi.setup.job_file import load

        return cls.of(load(comm or alone(), Path(path), takes_several=True), comm, path=Path(path))

    @classmethod
    def of(cls, job: Job, comm: Comm | None = None, given: Given = NOTHING, path: Path | None = None) -> Self:
        """Return what a job, with what is in memory, describes."""
        _end_together(comm)
        setup = cls.__new__(cls)
        setup.job, setup.given, setup.path, setup._comm = job, given, path, comm
        return setup

    @property
    def comm(self) -> Comm:
        """The ranks that work together."""
        from hydrabeam_mpi.mpi import alone

        return self._comm if self._comm is not None else alone()

    def of_each_polarization(self) -> list[Setup]:
        """Return the same for each polarisation alone."""
        from hydrabeam_mpi.setup.polarizations import jobs_of_each

        return [Setup.of(job, self._comm, self.given, self.path) for job in jobs_of_each(self.job)]

    def amended(self, job: Job) -> Setup:
        """Return the same data with another job."""
        return Setup.of(job, self._comm, self.given)

    @contextmanager
    def telling(self) -> Iterator[None]:
        """Tell of what is wrong by the job file's name, or by that of the argument."""
        try:
            with nullcontext() if self.path else arguments_named():
                yield
        except InputError as error:
            if self.path is not None:
                error.locate(self.path)
            raise


def _end_together(comm: Comm | None) -> None:
    """Let a script that ends with an exception on one rank end on all."""
    if comm is not None:
        from hydrabeam_mpi.mpi import install_abort_hook

        install_abort_hook(comm)


@contextmanager
def _together(comm: Comm | None) -> Iterator[None]:
    """Fail on all ranks where one does."""
    if comm is None:
        yield
        return
    from hydrabeam_mpi.mpi import together

    with together(comm):
        yield
