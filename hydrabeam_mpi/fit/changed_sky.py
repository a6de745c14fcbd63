"""What effects change of the sky at one time, and what a set of baselines sees of that."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.engines.base import SOURCES_AT_ONCE, Engine, amplitude
from hydrabeam_mpi.model.engines.fringes import enu

AT_ONCE_BYTES = 2**26
"""Of basis and fringes of the sources of several skies: more than that saves no more time."""


class SourcesOfChannels(NamedTuple):
    """Sources above the horizon: za and az, (Nsrc,) radians, and what they add to each channel, (Nfreqs, Nsrc) Jy."""

    za: FloatArray
    az: FloatArray
    flux: FloatArray


def changed_sky(blocks: Sequence[RowBlock], itime: int, left_out: Sequence[bool]) -> SourcesOfChannels:
    """Return by how much effects change the fluxes of sources at a time, and the sources that they add.

    Parameters
    ----------
    blocks : sequence of RowBlock
        Of each channel, with the effects that change the sky.
    itime : int
        Index into the observation's times.
    left_out : sequence of bool
        For each effect, whether what it adds is not wanted.
    """
    sources = [block.sources(itime) for block in blocks]
    changed = np.unique(np.concatenate([one.changed[0] for one in sources]))
    change = np.zeros((len(sources), len(changed)))
    for row, one in zip(change, sources, strict=True):
        which, by = one.changed
        row[np.searchsorted(changed, which)] = by
    parts = [SourcesOfChannels(sources[0].za[changed], sources[0].az[changed], change)]
    for number in np.flatnonzero(~np.array(left_out, dtype=bool)).tolist():
        added = [block.sky_effects[number][0].extra_sky(block, itime, block.sky_effects[number][1]) for block in blocks]
        if added[0] is not None:
            parts.append(_together(added))
    za, az, flux = (np.concatenate(one, axis=-1) for one in zip(*parts, strict=True))
    shines = flux.any(axis=0)
    return SourcesOfChannels(za[shines], az[shines], flux[:, shines])


def _together(channels: Sequence[tuple[FloatArray, FloatArray, FloatArray]]) -> SourcesOfChannels:
    """Join what is added to each channel: mostly sources at the same places."""
    za, az, flux = zip(*channels, strict=True)
    if all(np.array_equal(za[0], one) and np.array_equal(az[0], two) for one, two in zip(za, az, strict=True)):
        return SourcesOfChannels(za[0], az[0], np.array(flux))
    ends = np.cumsum([len(one) for one in flux])
    each = np.zeros((len(flux), ends[-1]))
    for row, one, end in zip(each, flux, ends.tolist(), strict=True):
        row[end - len(one) : end] = one
    return SourcesOfChannels(np.concatenate(za), np.concatenate(az), each)


def design_of_each(
    engine: Engine, basis: LinearBasis, skies: Iterable[SourcesOfChannels], freqs: FloatArray
) -> Iterator[FloatArray]:
    """Yield the design of each sky, (Nfreqs, 2, Nvectors, n_columns).

    Most have few sources, so that basis and fringes are evaluated for several at once, of up to `SOURCES_AT_ONCE`
    sources.
    """
    of_source = 8 * (2 * engine.n_vectors * len(freqs) + basis.n_columns)
    most = min(SOURCES_AT_ONCE, AT_ONCE_BYTES // of_source)
    waiting: list[SourcesOfChannels] = []
    for sky in skies:
        if sum(len(one.za) for one in waiting) + len(sky.za) > most:
            yield from _of_few_sources(engine, basis, waiting, freqs)
            waiting = []
        if len(sky.za) > most:
            yield _of_many_sources(engine, basis, sky, freqs)
        else:
            waiting.append(sky)
    yield from _of_few_sources(engine, basis, waiting, freqs)


def _of_few_sources(
    engine: Engine, basis: LinearBasis, skies: Sequence[SourcesOfChannels], freqs: FloatArray
) -> Iterator[FloatArray]:
    """Yield the design of some skies, whose sources are few enough to be held with all their fringes."""
    if not skies:
        return
    za, az, flux = (np.concatenate(one, axis=-1) for one in zip(*skies, strict=True))
    columns, directions = basis.columns(za, az), enu(za, az)
    fringes = np.empty((len(freqs), 2, engine.n_vectors, len(za)))
    for of_channel, seen, freq in zip(fringes, flux, freqs.tolist(), strict=True):
        engine.fringes.fill(of_channel, directions, amplitude(seen), freq)
    start = 0
    for sky in skies:
        own = slice(start, start + len(sky.za))
        yield fringes[..., own] @ columns[:, own].T
        start = own.stop


def _of_many_sources(engine: Engine, basis: LinearBasis, sky: SourcesOfChannels, freqs: FloatArray) -> FloatArray:
    """Return the design of one sky, of which channels may have sources of their own."""
    if sky.flux.all():
        return engine.design(basis, *sky, freqs)
    parts = []
    for flux, freq in zip(sky.flux, freqs, strict=True):
        shines = flux != 0
        parts.append(engine.design(basis, sky.za[shines], sky.az[shines], flux[np.newaxis, shines], np.array([freq])))
    return np.concatenate(parts)
