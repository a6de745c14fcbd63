"""Gains that files gave beside those that were found: per antenna, and with solutions that were not applied."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from astropy.coordinates import EarthLocation
from markupsafe import Markup

from hydrabeam_mpi.data.degenerate_gains import Degenerate, without_degenerate
from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, Observation
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.gains import antennas_of, mean_gains
from hydrabeam_mpi.report.page.parts import bullets, part, set_table, together
from hydrabeam_mpi.report.page.style import INFERRED, MODEL, REFERENCE, Drawing, new_figure
from hydrabeam_mpi.report.page.words import megahertz


@dataclass(frozen=True, eq=False)
class Solution:
    """Gains of one channel relative to those that were applied to the data, less what no data tell; (Nants,) each.

    Attributes
    ----------
    name : str
    ln_amplitude, phase : ndarray
        Radians; NaN where not known.
    removed : Degenerate
        What has been taken off.
    ln_amplitude_std, phase_std : ndarray, optional
    """

    name: str
    ln_amplitude: FloatArray
    phase: FloatArray
    removed: Degenerate
    ln_amplitude_std: FloatArray | None = None
    phase_std: FloatArray | None = None

    @property
    def words(self) -> str:
        """How large it is, and what has been taken off."""
        rms = [np.sqrt(np.nanmean(np.square(part))) for part in (self.ln_amplitude, self.phase)]
        removed, (east, north) = self.removed, self.removed.gradient
        return (
            f"{self.name}: rms {100 * rms[0]:.2g}% in amplitude and {np.rad2deg(rms[1]):.2g} deg in phase, less "
            f"{removed.ln_amplitude:.4f} of ln amplitude and {np.rad2deg(removed.phase):.2f} deg of phase of all "
            f"antennas, and a gradient of phase of {np.rad2deg(east):.3f} deg/m East and {np.rad2deg(north):.3f} deg/m "
            "North"
        )


@dataclass(frozen=True, eq=False)
class ChannelGains:
    """What is compared in one channel.

    Attributes
    ----------
    freq : float
        Hz.
    antennas : list of int
    given : ndarray of complex, (Nants,)
        One where no file was given.
    found : ndarray of complex, (Nants,)
    solutions : tuple of Solution
        What was found, where anything was, and the other files.
    """

    freq: float
    antennas: list[int]
    given: ComplexArray
    found: ComplexArray
    solutions: tuple[Solution, ...]


def compare_gains(told: dict[str, Any], others: Sequence[Path]) -> list[ChannelGains]:
    """Return what is to be compared in each channel.

    Parameters
    ----------
    told : dict
        ``gains`` of ``summary.json``.
    others : sequence of Path
        Files of gains that were not applied, each a solution of its own.

    Raises
    ------
    InputError
        If a file has no gains of these antennas, times and channels.
    """
    observation, files = _observation(told), [_read(path, told) for path in others]
    antennas = told["antennas"]
    compared = []
    for number, channel in enumerate(told["channels"]):
        given, found = (_gains(channel.get(name), len(antennas)) for name in ("given", "found"))
        solutions = []
        known = np.all([np.isfinite(gains[number]) for gains in files], axis=0) & np.isfinite(given * found)
        place = observation.antpos[:, :2], known
        if "found" in channel:
            std = (_array(channel["found"][f"{name}_std"]) for name in ("ln_amplitude", "phase"))
            solutions.append(Solution("found", *_relative(found, *place), *std))
        for path, gains in zip(others, files, strict=True):
            solutions.append(Solution(path.name, *_relative(gains[number] / given, *place)))
        compared.append(ChannelGains(channel["freq_hz"], antennas, given, found, tuple(solutions)))
    return compared


def _array(values: Sequence[float | None]) -> FloatArray:
    return np.array(values, dtype=float)


def _gains(parts: dict[str, Any] | None, n: int) -> ComplexArray:
    """Return gains, one where none are told."""
    if parts is None:
        return np.ones(n, dtype=complex)
    return np.exp(_array(parts["ln_amplitude"]) + 1j * _array(parts["phase"]))


def _relative(
    gains: ComplexArray, positions: FloatArray, known: BoolArray
) -> tuple[FloatArray, FloatArray, Degenerate]:
    return without_degenerate(np.log(np.abs(gains)), np.angle(gains), positions, known)


def _observation(told: dict[str, Any]) -> Observation:
    """Return what readers of gains ask of an observation."""
    antennas, n = np.array(told["antennas"]), len(told["antennas"])
    freqs = np.array([channel["freq_hz"] for channel in told["channels"]])
    times = np.array(told["times_jd"])
    return Observation(
        telescope_name="",
        # Gains do not depend on it; without one the name of the telescope would be looked up.
        location=EarthLocation.from_geodetic(0, 0),
        antenna_numbers=antennas,
        antenna_names=tuple(map(str, antennas)),
        antpos=np.column_stack([np.array(told["east_north_m"], dtype=float).reshape(n, 2), np.zeros(n)]),
        antpairs=np.zeros((0, 2), dtype=int),
        freqs=freqs,
        channel_width=np.zeros(len(freqs)),
        times=times,
        lsts=np.zeros(len(times)),
        integration_time=np.array(told["integration_time_s"]),
        pols=(2 * told["feed"],),
        pol_convention=told["pol_convention"],
    )


def _read(path: Path, told: dict[str, Any]) -> ComplexArray:
    """Return a file's gains, (Nfreqs, Nants), NaN of antennas that it does not have."""
    whole = _observation(told)
    known = np.isin(whole.antenna_numbers, antennas_of(path, whole))
    if not known.any():
        raise InputError("has none of the antennas of the data", file=path, field="--gains", remedy="give another file")
    numbers = np.flatnonzero(known).tolist()
    some = _observation(
        {**told, **{name: [told[name][number] for number in numbers] for name in ("antennas", "east_north_m")}}
    )
    gains = np.full((len(told["channels"]), len(known)), np.nan + 0j)
    gains[:, known] = mean_gains([path], some)
    return gains


def gains_body(told: dict[str, Any], others: Sequence[Path], place: Callable[[Drawing, str], Markup]) -> Markup:
    """Return the section of the page as HTML: the first, the middle and the last of many channels.

    Parameters
    ----------
    told, others
        As of `compare_gains`.
    place : callable
        Turns a figure into its element, with a prefix for its name.
    """
    compared = compare_gains(told, others)
    if len(compared) > 3:
        compared = [compared[0], compared[len(compared) // 2], compared[-1]]
    parts = [gains_text(told, compared)]
    for number, channel in enumerate(compared):
        drawing = draw_gains(channel)
        parts += [place(drawing, f"{number}_") if drawing else Markup(), gains_table(channel)]
    return together(*parts)


def gains_text(told: dict[str, Any], compared: Sequence[ChannelGains]) -> Markup:
    """Return the introduction, as HTML."""
    files = [f"{one['file']} (SHA-256 {one['sha256'][:16]}…)" for one in told["files"]]
    said = [f"{megahertz(one.freq)}, {solution.words}" for one in compared for solution in one.solutions]
    what = (
        "Relative to the gains that were applied, and less what no data of an array with one beam tell of gains: "
        "the mean ln amplitude, the mean phase, and a gradient of phase along the ground."
    )
    if not files:
        return together(part("paragraph", "No gains of files were applied to the data."), bullets(said, what))
    return together(
        bullets(files, "The data were divided by g_i g_j* of these files before the fit:"), bullets(said, what)
    )


def gains_table(channel: ChannelGains) -> Markup:
    """Set what was given, found, and both together, by antenna, beside other solutions."""
    names = ["antenna", "given: amplitude", "phase, deg"]
    columns = _amplitude_and_phase(channel.given)
    if any(one.name == "found" for one in channel.solutions):
        names += ["given × found: amplitude", "phase, deg"]
        columns += _amplitude_and_phase(channel.given * channel.found)
    for one in channel.solutions:
        names += [f"{one.name}: amplitude, %", "phase, deg"]
        columns.append(_with_errors(100 * one.ln_amplitude, one.ln_amplitude_std, 100.0))
        columns.append(_with_errors(np.rad2deg(one.phase), one.phase_std, float(np.rad2deg(1.0))))
    rows = [(str(antenna), *cells) for antenna, *cells in zip(channel.antennas, *columns, strict=True)]
    return set_table(names, rows, range(len(names)))


def _amplitude_and_phase(gains: ComplexArray) -> list[list[str]]:
    return [_with_errors(np.abs(gains), digits=4), _with_errors(np.rad2deg(np.angle(gains)))]


def _with_errors(values: FloatArray, std: FloatArray | None = None, scale: float = 1.0, digits: int = 2) -> list[str]:
    """Write numbers, with errors where there are any, and a dash where there is no number."""
    errors = [""] * len(values) if std is None else [f" +- {scale * one:.1g}" for one in std]
    return [
        f"{value:.{digits}f}{error}" if np.isfinite(value) else "–" for value, error in zip(values, errors, strict=True)
    ]


def draw_gains(channel: ChannelGains) -> Drawing | None:
    """Draw amplitudes and phases of all solutions relative to what was applied, by antenna."""
    if not channel.solutions:
        return None
    figure = new_figure(4.6)
    above, below = figure.subplots(2, 1, sharex=True)
    place, width = np.arange(len(channel.antennas)), 0.5 / len(channel.solutions)
    for number, (one, colour, marker) in enumerate(_looks(channel.solutions)):
        x = place + width * (number - (len(channel.solutions) - 1) / 2)
        for axes, values, std, scale in (
            (above, one.ln_amplitude, one.ln_amplitude_std, 100.0),
            (below, one.phase, one.phase_std, float(np.rad2deg(1.0))),
        ):
            error = None if std is None else scale * std
            axes.errorbar(x, scale * values, error, fmt=marker, ms=4.5, color=colour, capsize=2, label=one.name)
    for axes, label in ((above, "amplitude, %"), (below, "phase, deg")):
        axes.axhline(0, color="0.7", lw=0.7, zorder=0)
        axes.set_ylabel(label)
        axes.grid(axis="x")
    step = -(-len(place) // 40)
    below.set_xticks(place[::step], [str(antenna) for antenna in channel.antennas[::step]])
    below.set_xlabel("antenna")
    above.legend(ncols=3, loc="lower left", bbox_to_anchor=(0, 1))
    return Drawing(
        "gains",
        f"Gains relative to those that were applied, {megahertz(channel.freq)}",
        "By antenna, less the mean ln amplitude, the mean phase and a gradient of phase along the ground, which no "
        "data tell. What was found has the errors of the fit. A solution that lies at zero is the one that was "
        "applied; one that lies on what was found agrees with it.",
        f"Two panels, amplitude and phase, with {len(channel.solutions)} points for each of {len(place)} antennas.",
        figure,
    )


def _looks(solutions: Sequence[Solution]) -> Iterator[tuple[Solution, str, str]]:
    """Give each solution a colour and a marker: first what was found."""
    colours, markers = (MODEL, REFERENCE, "#009e73", "#7b3294"), "sD^v"
    number = 0
    for one in solutions:
        if one.ln_amplitude_std is not None:
            yield one, INFERRED, "o"
        else:
            yield one, colours[number % len(colours)], markers[number % len(markers)]
            number += 1
