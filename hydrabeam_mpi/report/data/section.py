"""What the page shows of the data: held-out visibilities, their spectra, the array and the sources."""

from __future__ import annotations

from collections.abc import Callable

from markupsafe import Markup

from hydrabeam_mpi.report.data.array import draw_array
from hydrabeam_mpi.report.data.baselines import draw_baselines
from hydrabeam_mpi.report.data.sample import sample_of
from hydrabeam_mpi.report.data.spectra import draw_spectra
from hydrabeam_mpi.report.data.tracks import draw_tracks
from hydrabeam_mpi.report.data.visibilities import draw_visibilities, draw_waterfall
from hydrabeam_mpi.report.page.parts import part, together
from hydrabeam_mpi.report.page.result import Result
from hydrabeam_mpi.report.page.style import Drawing


def data_body(result: Result, place: Callable[[Drawing], Markup]) -> Markup:
    """Return the section as HTML: of the channel in the middle, but for spectra over delay.

    Parameters
    ----------
    result : Result
    place : callable
        Turns a figure into its element.
    """
    middle = result.channels[len(result.channels) // 2]
    samples = [sample for channel in result.channels if (sample := sample_of(result, channel)) is not None]
    of_middle = sample_of(result, middle)
    shown = [
        draw_visibilities(of_middle) if of_middle else None,
        draw_waterfall(of_middle) if of_middle else None,
        draw_spectra(samples) if samples else None,
        draw_array(result, middle),
        draw_baselines(result, middle),
    ]
    tracks = draw_tracks(result, middle)
    figures = [place(drawing) for drawing in shown if drawing is not None]
    if tracks is not None:
        figures.append(part("folded", "The brightest sources over the beam", place(tracks)))
    return together(*figures)
