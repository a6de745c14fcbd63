"""``hydrabeam report DIR``: figures and one self-contained page."""

from __future__ import annotations

import os
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import matplotlib
from markupsafe import Markup

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.disk import replacing
from hydrabeam_mpi.io.manifest import MANIFEST, add_to_manifest
from hydrabeam_mpi.io.together import folders_of_each
from hydrabeam_mpi.report.beam.frequencies import draw_frequencies
from hydrabeam_mpi.report.beam.sky import draw_maps
from hydrabeam_mpi.report.data.section import data_body
from hydrabeam_mpi.report.figures import draw_channel, draw_details, shown_channels
from hydrabeam_mpi.report.gains import gains_body
from hydrabeam_mpi.report.loop.record import as_written, load_loop
from hydrabeam_mpi.report.loop.section import loop_answer, loop_sections
from hydrabeam_mpi.report.loop.words import verdict_words
from hydrabeam_mpi.report.page.key_numbers import as_text, table
from hydrabeam_mpi.report.page.parts import Answer, Section, part, set_page, together
from hydrabeam_mpi.report.page.result import Channel, Result, load_result
from hydrabeam_mpi.report.page.sections import channel_table, errors_table, finding, key_numbers, provenance
from hydrabeam_mpi.report.page.style import STYLE, Drawing, render
from hydrabeam_mpi.report.page.words import answer_words, introduction, megahertz, over_frequency_words, remarks
from hydrabeam_mpi.sampling.storage.store import ChainStore

FOOTER = "“The paper” is Wilensky et al. 2025, High Dimensional Beam Inference II, whose method this is."


def write_report(directory: Path, other_gains: Sequence[Path] = ()) -> None:
    """Write ``report.html`` and ``figures/`` into a result folder, and print its key numbers.

    Everything is drawn before the first file is written, and each file appears whole.

    Parameters
    ----------
    directory : Path
        Folder that ``hydrabeam infer`` or ``hydrabeam loop`` wrote, or that ``hydrabeam sample`` wrote or is writing;
        of several polarisations each gets its own.
    other_gains : sequence of Path
        Files of gains that were not applied to the data, to be compared with those that were given and found.

    Raises
    ------
    InputError
        If it is no such folder, or cannot be written.
    """
    if ChainStore.exists(directory) and not other_gains:
        _write_chains(directory)
        return
    if parts := folders_of_each(directory):
        for part_of_one in parts.values():
            write_report(part_of_one, other_gains)
        return
    loop = load_loop(directory)
    result = load_result(directory)
    told = result.numbers.get("gains")
    if other_gains and not told:
        remedy = "name a result with gains, of files or found, made with this version"
        raise InputError("tells of no gains", file=directory / "summary.json", field="gains", remedy=remedy)
    contents: dict[Path, bytes] = {}
    album = _Album(contents, directory / "figures")
    with matplotlib.rc_context(STYLE):
        maps = draw_maps(result.channels[0])
        picture = album.place(maps, _prefix(result, result.channels[0])) if maps else Markup()
        answer, sections = _answer(result, picture), []
        if loop is not None:
            with as_written(directory):
                answer = loop_answer(loop, picture, answer.warnings)
                sections = loop_sections(loop, album.place)
        with as_written(directory, "posterior.h5"):
            sections.append(Section("Data, model and residual", data_body(result, album.place)))
        sections += _set_up(result, " of the amended model" if loop is not None else "")
        with as_written(directory, "summary.json"):
            sections += [Section("Gains", gains_body(told, other_gains, album.place))] if told else []
        sections += [*_channels(result, album), Section("Provenance", provenance(result))]
    _write_page(directory, set_page(f"Beam posterior: {result.name}", answer, sections, FOOTER), contents)
    print(introduction(result), end="\n\n")
    print(as_text(table(result.numbers, result.name)), end="\n\n")
    for remark in remarks(result):
        print(f"Note: {remark}")
    if loop is not None:
        print(verdict_words(loop))
    print(f"Report: {directory / 'report.html'}")


def _write_chains(directory: Path) -> None:
    """Write the page of a folder of chains, and print how far they are."""
    # What compares chains takes seconds to import.
    from hydrabeam_mpi.report.chains.section import chains_page
    from hydrabeam_mpi.sampling.status import status_of

    store = ChainStore.open(directory)
    status = status_of(store)
    contents: dict[Path, bytes] = {}
    album = _Album(contents, directory / "figures")
    title = f"Chains: {Path(os.path.realpath(directory)).name}"
    with matplotlib.rc_context(STYLE):
        page = set_page(title, *chains_page(store, status, album.place), FOOTER)
    _write_page(directory, page, contents)
    print(status, end="\n\n")
    print(f"Report: {directory / 'report.html'}")


def _write_page(directory: Path, page: str, contents: dict[Path, bytes]) -> None:
    """Write the page and its figures."""
    contents[directory / "report.html"] = page.encode()
    for path, content in contents.items():
        _write_file(path, content)
    _list_files(directory, contents)


def _write_file(path: Path, content: bytes) -> None:
    """Write a file under another name and rename it."""
    with _to_folder(path):
        path.parent.mkdir(exist_ok=True)
        with replacing(path) as partial:
            partial.write_bytes(content)


@contextmanager
def _to_folder(path: Path) -> Iterator[None]:
    """Say in one line that a file cannot be written."""
    try:
        yield
    except OSError as error:
        remedy = "make the folder writable"
        raise InputError(f"cannot be written ({error.strerror})", file=path, remedy=remedy) from error


def _list_files(directory: Path, paths: Iterable[Path]) -> None:
    """Make files part of the result, as what --overwrite may replace."""
    with _to_folder(directory / MANIFEST):
        add_to_manifest(directory, (str(path.relative_to(directory)) for path in paths))


class _Album:
    """Numbers the figures of the page, renders them, and keeps their files for writing."""

    def __init__(self, contents: dict[Path, bytes], folder: Path) -> None:
        self._contents, self._folder = contents, folder
        self._numbers = count(1)

    def place(self, drawing: Drawing, prefix: str = "") -> Markup:
        """Return a figure element with its picture inside."""
        name = prefix + drawing.name
        pictures = render(drawing.figure)
        for form, content in pictures.items():
            self._contents[self._folder / f"{name}.{form}"] = content
        return part("figure", name, next(self._numbers), drawing, b64encode(pictures["png"]).decode())


def _answer(result: Result, picture: Markup) -> Answer:
    return Answer(answer_words(result.channels), errors_table(result.channels), picture, remarks(result))


def _set_up(result: Result, of_model: str) -> list[Section]:
    """Tell what was inferred from what, and its key numbers."""
    first = f" of the first channel, {megahertz(result.channels[0].freq)}" if len(result.channels) > 1 else ""
    return [
        Section("Set-up", part("paragraph", introduction(result))),
        Section(f"Key numbers{of_model}{first}", key_numbers(result)),
    ]


def _channels(result: Result, album: _Album) -> Iterator[Section]:
    """Place the figures of all channels together, then of the chosen ones."""
    channels, shown = result.channels, shown_channels(result.channels)
    several = len(channels) > 1
    together_drawn = draw_frequencies(channels, over_frequency_words(result.numbers))
    if together_drawn is not None:
        rest = "The first, the middle and the last channel follow in full."
        pieces = (album.place(together_drawn), channel_table(channels))
        yield Section("All channels", together(*pieces, part("paragraph", rest if len(shown) < len(channels) else "")))
    for channel in shown:
        title = f"Channel {channel.number}, {megahertz(channel.freq)}" if several else "The beam in detail"
        shown_open, folded = (
            together(*(album.place(drawing, _prefix(result, channel)) for drawing in drawings))
            for drawings in (draw_channel(channel, with_maps=channel is not channels[0]), draw_details(channel))
        )
        details = part("folded", "Coefficients, correlations, eigenbeams", folded)
        yield Section(title, together(finding(channel), shown_open, details))


def _prefix(result: Result, channel: Channel) -> str:
    """Tell the files of one channel from those of others."""
    return f"channel_{channel.number:04d}_" if len(result.channels) > 1 else ""
