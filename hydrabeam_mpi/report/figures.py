"""All figures of a result, in the order of the page."""

from __future__ import annotations

from collections.abc import Iterator

from hydrabeam_mpi.report.beam.coefficients import draw_coefficients
from hydrabeam_mpi.report.beam.corner import draw_corner
from hydrabeam_mpi.report.beam.correlation import draw_correlation
from hydrabeam_mpi.report.beam.eigenbeams import draw_eigenbeams
from hydrabeam_mpi.report.beam.predictive_checks import draw_heldout_scores
from hydrabeam_mpi.report.beam.sky import draw_map_scores, draw_maps, draw_slices
from hydrabeam_mpi.report.page.result import Channel
from hydrabeam_mpi.report.page.style import Drawing


def shown_channels(channels: list[Channel]) -> list[Channel]:
    """Choose the channels that are drawn in full: all, or the first, the middle and the last of more than three."""
    if len(channels) <= 3:
        return channels
    return [channels[0], channels[len(channels) // 2], channels[-1]]


def draw_channel(channel: Channel, with_maps: bool) -> Iterator[Drawing]:
    """Draw one channel: on the sky first, unless its maps begin the page, then held-out data."""
    drawings = (
        draw_maps(channel) if with_maps else None,
        draw_slices(channel),
        draw_map_scores(channel),
        draw_heldout_scores(channel),
    )
    yield from (drawing for drawing in drawings if drawing is not None)


def draw_details(channel: Channel) -> Iterator[Drawing]:
    """Draw what few readers ask for: coefficients and their covariance."""
    covariance = channel.covariance()
    drawings = (
        draw_coefficients(channel),
        draw_corner(channel, covariance),
        draw_correlation(channel, covariance),
        draw_eigenbeams(channel, covariance),
    )
    yield from (drawing for drawing in drawings if drawing is not None)
