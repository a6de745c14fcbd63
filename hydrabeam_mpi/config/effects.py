"""The tables of a job file about effects: in the model, in a simulation, and in the search of the loop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from hydrabeam_mpi.config.base import Section, key, refuse_unused
from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.effects.registry import KINDS, REWEIGHTINGS

if TYPE_CHECKING:
    Kind = str
else:  # a job may name what there is
    Kind = Literal[KINDS]


Value = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Width = Annotated[float, Field(ge=1 / LARGEST, le=LARGEST)]


def _by_channel(widths: Any) -> Any:
    """Take numbers alone for the one list that is of all channels."""
    if not isinstance(widths, list | tuple):
        return widths
    rows = [tuple(one) if isinstance(one, list) else one for one in widths]
    return tuple(rows) if any(isinstance(one, tuple) for one in rows) else (tuple(rows),) if rows else ()


class Effect(Section):
    """An effect that is part of the model; `hydrabeam loop` writes these."""

    kind: Kind = key(..., "which effect")
    settings: dict[str, Any] = key({}, "which of several, such as the positions of sources")
    names: tuple[str, ...] = key((), "of the parameters in use")
    index: tuple[Annotated[int, Field(ge=0)], ...] = key((), "their numbers among all of the effect's parameters")
    values: tuple[tuple[Value, ...], ...] = key((), "one list a channel, where `inference` starts")
    std: tuple[tuple[Value, ...], ...] = key((), "posterior standard deviations, likewise")
    prior_std: Annotated[tuple[tuple[Width, ...], ...], BeforeValidator(_by_channel)] = key(
        (), "of the prior about zero, one list for all channels or one for each"
    )

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        lengths = {len(row) for row in (*self.values, *self.std, *self.prior_std)}
        if self.kind not in REWEIGHTINGS:  # their parameters have neither names nor priors in a job
            lengths |= {len(self.names), len(set(self.index)), len(self.index), *([] if self.prior_std else [0])}
        if 0 in lengths or len(lengths) > 1 or len(self.std) not in (0, len(self.values)):
            raise ValueError(
                "names, index, prior_std and every list in values and std go together, one entry a parameter"
                "; use the table as 'hydrabeam loop' wrote it"
            )
        return self


class Injected(Section):
    """An effect to simulate with: given parameters, or drawn at random."""

    kind: Kind = key(..., "which effect")
    settings: dict[str, Any] = key({}, "which of several, such as the positions of sources")
    strength: float = key(0.1, "rms of the parameters drawn, over their natural size", gt=0)
    parameters: dict[str, Value] = key({}, "instead: values by name, the others zero")

    @model_validator(mode="after")
    def _is_drawn_or_given(self) -> Self:
        if self.parameters and self.strength != type(self).model_fields["strength"].default:
            refuse_unused(self, "strength", "parameters drawn at random", "those that are given")
        return self


class Loop(Section):
    """How `hydrabeam loop` looks for what the model lacks."""

    effects: tuple[Kind, ...] = key((), "only these; all by default")
    skip: tuple[Kind, ...] = key((), "not these")
    max_rounds: int = key(6, "effects added at most; others may still take their place", ge=0)
    min_log_bayes_factor: float = key(
        5.0,
        "nats by which an effect must raise the density of held-out data, and the evidence (times the reduced chi^2 "
        "that is left, if above 1)",
        gt=0,
    )
