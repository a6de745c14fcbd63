"""The table of a job that says how the beams of its channels hang together."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from hydrabeam_mpi.config.base import Section, key, refuse_unused
from hydrabeam_mpi.config.quantities import Bandwidth, Seconds

Lengths = Annotated[
    tuple[Bandwidth, ...],
    BeforeValidator(lambda lengths: tuple(lengths) if isinstance(lengths, list | tuple) else (lengths,)),
    PlainSerializer(lambda lengths: lengths[0] if len(lengths) == 1 else lengths),
]
"""One, written as a number, or several among which the evidence decides."""
MODES, PROCESS = ("kind", "modes"), ("kind", "gaussian-process")


class OverFrequency(Section):
    """How coefficients, in units of their prior's width, hang together over channels."""

    kind: Literal["independent", "modes", "gaussian-process"] = key(
        "independent", "every channel for itself, a few functions of frequency, or a covariance over frequency"
    )
    modes: Literal["legendre", "dpss"] = key("legendre", "polynomials, or all that lies within a delay", MODES)
    n_modes: int | None = key(None, "how many; of 'dpss' as many as there are by default", MODES, ge=1)
    delay: Annotated[Seconds, Field(gt=0, le=1)] | None = key(None, "s, half-width of 'dpss'; '100 ns'", MODES)
    kernel: Literal["squared-exponential", "matern-3/2", "matern-5/2"] = key(
        "squared-exponential", "covariance over frequency", PROCESS
    )
    length: Lengths = key((), "Hz, of the kernel; by default, or of several, as the evidence has it", PROCESS)
    evidence: Literal["maximise", "marginalise"] = key(
        "maximise", "of several lengths the likeliest, or the mean over all by their evidence", PROCESS
    )
    solver: Literal["auto", "dense", "conjugate-gradients"] = key(
        "auto", "one matrix on one rank, or none on any; 'auto' takes the first where it is not too large"
    )

    @property
    def couples(self) -> bool:
        """Whether channels know of each other."""
        return self.kind != "independent"

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        if self.kind == "modes" and self.modes == "legendre" and self.n_modes is None:
            raise ValueError("modes = 'legendre' needs n_modes; give n_modes = 3 or so")
        if self.kind == "modes" and (self.modes == "dpss") != (self.delay is not None):
            raise ValueError("modes = 'dpss' and delay go together; give both, such as 'dpss' and '100 ns', or neither")
        if not self.couples and self.solver != "auto":
            refuse_unused(self, "solver", "channels that hang together", "kind = 'independent'")
        return self
