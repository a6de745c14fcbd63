"""Beams with what effects add to their coefficients, such as what all channels have in common.

The coefficients b of a channel's beam and the effects' parameters x are

    x ~ N(x_0, C),    b | x ~ N(b_0 + M (x - x_0), P^-1).

Some parameters u of these are part of the beam, which is t = b + W u. With the others, v, it is

    t | v ~ N(t_0 + M' (v - v_0), P^-1 + S S^H),    M' = M_v + (M_u + W) C_uv C_vv^-1,

where S S^H = (M_u + W) (C_uu - C_uv C_vv^-1 C_vu) (M_u + W)^H. That is a fit of beams t and effects v, by which
data are predicted and results written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.grown import added_coefficients, added_response, adds_coefficients, wider
from hydrabeam_mpi.fit.state import Fit, Fitted
from hydrabeam_mpi.fit.whitening import root_of
from hydrabeam_mpi.inference.matrices import inverse_of_covariance
from hydrabeam_mpi.inference.posterior import Posterior


def with_whole_beams(context: FitContext, fitted: Fitted) -> Fitted:
    """Return the fit with beams that have in them what effects add to their coefficients, and without these effects."""
    inside = [adds_coefficients(context.setup, one) for one in fitted.values.active]
    if not any(inside):
        return fitted
    return context.of_latest("whole beams", fitted, lambda: _with_whole_beams(context, fitted, inside))


def _with_whole_beams(context: FitContext, fitted: Fitted, inside: Sequence[bool]) -> Fitted:
    setup, values, fit = context.setup, fitted.values, fitted.fit
    of_beam = np.repeat(inside, [one.size for one in values.active])
    follow = added_response(setup, values)
    parts = zip(fit.posteriors, fit.covariances, fit.beam_response, context.channels, strict=True)
    channels = []
    for beam, covariance, response, channel in parts:
        whole = replace(beam, mean=beam.mean + added_coefficients(setup, values, channel))
        channels.append(_whole(whole, covariance, response + follow, of_beam))
    beams, covariances, responses = zip(*channels, strict=True)
    others = [not one for one in inside]
    std = tuple(one for one, is_other in zip(fit.std, others, strict=True) if is_other)
    active = tuple(one for one, is_other in zip(values.active, others, strict=True) if is_other)
    return replace(fitted, values=replace(values, active=active), fit=Fit(beams, covariances, responses, std))


def _whole(
    beam: Posterior, covariance: FloatArray, response: Array, of_beam: Array
) -> tuple[Posterior, FloatArray, Array]:
    """Return t given the other effects, their covariance, and the response of t to them.

    ``beam`` is given all effects, at t_0; ``response`` has W in it, and ``of_beam``, (q,), says which parameters are u.
    """
    own, others = np.flatnonzero(of_beam), np.flatnonzero(~of_beam)
    left, kept = covariance[np.ix_(own, own)], covariance[np.ix_(others, others)]
    moved = response[:, others]
    if len(others):
        across = covariance[np.ix_(own, others)] @ inverse_of_covariance(kept)
        left = left - across @ covariance[np.ix_(others, own)]
        moved = moved + response[:, own] @ across
    return wider(beam, response[:, own] @ root_of(left)), kept, moved
