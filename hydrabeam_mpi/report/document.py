"""``hydrabeam report DIR``: figures and one self-contained page."""

from __future__ import annotations

import os
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from importlib.resources import files
from itertools import count
from pathlib import Path

import matplotlib

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.disk import replacing
from hydrabeam_mpi.io.manifest import MANIFEST, add_to_manifest
from hydrabeam_mpi.report.beam.frequencies import draw_frequencies
from hydrabeam_mpi.report.figures import draw_channel, shown_channels
from hydrabeam_mpi.report.gains import gains_section
from hydrabeam_mpi.report.loop.record import as_written, load_loop
from hydrabeam_mpi.report.loop.section import loop_section
from hydrabeam_mpi.report.loop.words import verdict_words
from hydrabeam_mpi.report.page.key_numbers import table, text_table
from hydrabeam_mpi.report.page.result import Result, load_result
from hydrabeam_mpi.report.page.sections import channel_table, finding, key_numbers, provenance, warnings
from hydrabeam_mpi.report.page.style import STYLE, Drawing, render
from hydrabeam_mpi.report.page.words import introduction, megahertz, over_frequency_words, remarks
from hydrabeam_mpi.sampling.storage.store import ChainStore

FOOTER = "“The paper” is Wilensky et al. 2025, High Dimensional Beam Inference II, whose method this is."


def write_report(directory: Path, other_gains: Sequence[Path] = ()) -> None:
    """Write ``report.html`` and ``figures/`` into a result folder, and print its key numbers.

    Everything is drawn before the first file is written, and each file appears whole.

    Parameters
    ----------
    directory : Path
        Folder that ``hydrabeam infer`` or ``hydrabeam loop`` wrote, or that ``hydrabeam sample`` wrote or is writing.
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
    loop = load_loop(directory)
    if loop is not None and loop["verdict"] == "interrupted":
        remedy = "run its command again to go on, or 'hydrabeam infer' with its amended.toml"
        raise InputError(
            "is of a loop that was interrupted: it has rounds, and no posterior", file=directory, remedy=remedy
        )
    result = load_result(directory)
    told = result.numbers.get("gains")
    if other_gains and not told:
        remedy = "name a result with gains, of files or found, made with this version"
        raise InputError("tells of no gains", file=directory / "summary.json", field="gains", remedy=remedy)
    contents: dict[Path, bytes] = {}
    album = _Album(contents, directory / "figures")
    of_loop = verdict = ""
    with matplotlib.rc_context(STYLE):
        if loop is not None:
            with as_written(directory):
                of_loop, verdict = loop_section(loop, album.place), verdict_words(loop)
        with as_written(directory, "summary.json"):
            of_gains = gains_section(told, other_gains, album.place) if told else ""
        page = _page(result, of_loop, album, of_gains)
    _write_page(directory, page, contents)
    print(introduction(result), end="\n\n")
    print(text_table(table(result.numbers, result.name)), end="\n\n")
    for remark in remarks(result):
        print(f"Note: {remark}")
    if verdict:
        print(verdict)
    print(f"Report: {directory / 'report.html'}")


def _write_chains(directory: Path) -> None:
    """Write the page of a folder of chains, and print how far they are."""
    # What compares chains takes seconds to import.
    from hydrabeam_mpi.report.chains.section import chains_body
    from hydrabeam_mpi.sampling.status import status_of

    store = ChainStore.open(directory)
    status = status_of(store)
    contents: dict[Path, bytes] = {}
    album = _Album(contents, directory / "figures")
    title = f"Chains: {Path(os.path.realpath(directory)).name}"
    with matplotlib.rc_context(STYLE):
        page = _framed(title, f"<h1>{escape(title)}</h1>\n{chains_body(store, status, album.place)}")
    _write_page(directory, page, contents)
    print(status, end="\n\n")
    print(f"Report: {directory / 'report.html'}")


def _write_page(directory: Path, page: str, contents: dict[Path, bytes]) -> None:
    """Write the page and its figures."""
    contents[directory / "report.html"] = page.encode()
    for path, content in contents.items():
        _write_whole(path, content)
    _list_files(directory, contents)


def _write_whole(path: Path, content: bytes) -> None:
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

    def place(self, drawing: Drawing, prefix: str = "") -> str:
        """Return a figure element with its picture inside."""
        name = prefix + drawing.name
        pictures = render(drawing.figure)
        for form, content in pictures.items():
            self._contents[self._folder / f"{name}.{form}"] = content
        source = b64encode(pictures["png"]).decode()
        return (
            f'<figure id="{escape(name)}"><img alt="{escape(drawing.alt)}" src="data:image/png;base64,{source}">'
            f"<figcaption><b>Figure {next(self._numbers)}. {escape(drawing.title)}.</b> {escape(drawing.caption)} "
            f'<span class="key">figures/{escape(name)}.pdf</span></figcaption></figure>\n'
        )


def _page(result: Result, of_loop: str, album: _Album, of_gains: str) -> str:
    title = f"Beam posterior: {result.name}"
    body = [
        f"<h1>{escape(title)}</h1>\n<p>{escape(introduction(result))}</p>\n",
        f"{of_loop}<h2>The beam of the amended model</h2>\n" if of_loop else "",
        finding(result.channels[0]) if len(result.channels) == 1 else "",
        warnings(result),
        key_numbers(result),
        of_gains,
        _channels(result, album),
        provenance(result),
    ]
    return _framed(title, "".join(body))


def _framed(title: str, body: str) -> str:
    """Return a whole page."""
    style = files("hydrabeam_mpi.report.page").joinpath("page.css").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n{body}"
        f"<footer>{FOOTER}</footer>\n</body>\n</html>\n"
    )


def _channels(result: Result, album: _Album) -> str:
    """Place the figures of all channels together, then of the chosen ones."""
    several = len(result.channels) > 1
    shown = shown_channels(result.channels)
    parts = []
    together = draw_frequencies(result.channels, over_frequency_words(result.numbers))
    if together is not None:
        parts.append(f"<h2>All channels</h2>\n{album.place(together)}{channel_table(result.channels)}")
    if len(shown) < len(result.channels):
        parts.append("<p>The first, the middle and the last channel follow in full.</p>\n")
    for channel in shown:
        heading = f"Channel {channel.number}, {megahertz(channel.freq)}" if several else "Figures"
        prefix = f"channel_{channel.number:04d}_" if several else ""
        parts.append(f"<h2>{heading}</h2>\n{finding(channel) if several else ''}")
        parts.extend(album.place(drawing, prefix) for drawing in draw_channel(channel))
    return "".join(parts)
