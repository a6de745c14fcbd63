"""The table of a job file about chains."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from hydrabeam_mpi.config.base import Section, key
from hydrabeam_mpi.config.quantities import Degrees
from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.effects.registry import EFFECTS

BEAM, NOISE, PRIOR_WIDTH = "beam", "noise", "prior_width"
"""Blocks that are no effects."""

if TYPE_CHECKING:
    BlockName = str
    EffectKind = str
else:  # a job may name what there is
    BlockName = Literal[(BEAM, NOISE, PRIOR_WIDTH, *EFFECTS)]
    EffectKind = Literal[tuple(EFFECTS)]

Number = Annotated[float, Field(gt=0, le=LARGEST)]
Spacing = Annotated[Degrees, Field(ge=1, le=90)]


class SampledEffect(Section):
    """An effect that is drawn although the job's model has none of it."""

    kind: EffectKind = key(..., "which effect")
    settings: dict[str, Any] = key({}, "which of several, such as the positions of sources")
    foremost: int | None = key(None, "instead: so many, those that matter most, such as the brightest sources", ge=1)
    width: Number = key(1.0, "standard deviation of the prior about zero, over the parameters' natural size")
    prior_std: dict[str, Number] = key({}, "instead, of single parameters by name, in their units")
    draw_widths: bool = key(False, "draw the prior's widths too, one for each thing, such as a degree of harmonics")

    @model_validator(mode="after")
    def _says_which_once(self) -> Self:
        if self.foremost is not None and self.settings:
            raise ValueError("settings and foremost both say which; leave one of them out")
        return self


class Sample(Section):
    """How `hydrabeam sample` draws beams and all else together."""

    blocks: tuple[BlockName, ...] = key(
        (), f"what is drawn: '{BEAM}' (always), '{NOISE}', '{PRIOR_WIDTH}', kinds of effects; all effects by default"
    )
    chains: int = key(4, "of different beginnings", ge=1)
    draws: int = key(1000, "of each chain, after its warm-up", ge=1)
    warm_up: int = key(100, "draws in which proposals still learn; they are kept apart", ge=0)
    thin: int = key(1, "sweeps for each draw", ge=1)
    collapsed: bool = key(True, "draw effects with the beam integrated out; else given the beam, which mixes slowly")
    heldout: bool = key(True, "compare each draw's prediction with the rows that are held out, if there are any")
    positive_beam: Spacing | None = key(
        None, "beams are nowhere negative at points of the sky so far apart, deg; '3 deg' or so; not asked by default"
    )
    noise_prior: tuple[Number, Number] = key(
        (1.0, 1.0), "shape and scale of the inverse gamma that the noise variance over the stated one has"
    )
    noise_groups: Literal["all", "antenna", "length"] = key(
        "all", "what has one scale: all data; each antenna, whose two multiply; baselines of the same length"
    )
    noise_dof: Number | None = key(None, "noise of Student's t with so many degrees of freedom; Gaussian by default")
    width_prior: tuple[Number, Number] = key((1.0, 1.0), "the same of variances of priors over the stated ones")
    width_groups: Literal["all", "radial", "azimuthal"] = key("all", "modes that have one width: of the same order")
    effects: tuple[SampledEffect, ...] = ()

    @model_validator(mode="after")
    def _draws_what_it_names(self) -> Self:
        kinds = [one.kind for one in self.effects]
        left_out = [kind for kind in kinds if self.blocks and kind not in self.blocks]
        if left_out:
            raise ValueError(f"effects has {left_out[0]}, and blocks has not; add it to blocks")
        twice = [kind for kind in kinds if kinds.count(kind) > 1]
        if twice:
            raise ValueError(f"effects has {twice[0]} twice; give all of its settings once")
        return self
