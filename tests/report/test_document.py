"""The report of real results: whole, self-contained, true to ``summary.json``, and robust to what is missing."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.manifest import find_strangers, read_manifest
from hydrabeam_mpi.report.document import write_report
from tests.report.conftest import BULK, Edit, drop_arrays

OF_DATA = {"visibilities", "waterfall", "array", "baselines", "tracks"}
WITHOUT_MAPS = {"coefficients", "corner", "correlation"}
WITHOUT_HELDOUT = WITHOUT_MAPS | {"maps", "slices", "map_scores", "eigenbeams"}
FIGURES = WITHOUT_HELDOUT | OF_DATA | {"heldout_scores"}


@dataclass
class Page(HTMLParser):
    """What tests ask of a page: its links, images, table cells, text and whether its tags are balanced."""

    links: list[str] = field(default_factory=list)
    images: list[dict[str, str | None]] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    tags: set[str] = field(default_factory=set)
    sections: set[str | None] = field(default_factory=set)
    open_tags: list[str] = field(default_factory=list)
    text: str = ""

    def __post_init__(self) -> None:
        super().__init__()

    @classmethod
    def of(cls, directory: Path) -> Page:
        parser = cls()
        parser.feed((directory / "report.html").read_text(encoding="utf-8"))
        parser.close()
        return parser

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        self.tags.add(tag)
        self.links += [value for key, value in attrs if key in ("src", "href", "srcset", "data") and value]
        if tag == "section":
            self.sections.add(attributes["id"])
        if tag == "img":
            self.images.append(attributes)
        elif tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in ("img", "meta"):
            self.open_tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open_tags.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        if "td" in self.open_tags or "th" in self.open_tags:
            exponent = "e" if self.open_tags[-1] == "sup" else ""
            self.rows[-1][-1] += exponent + data


def number(text: str) -> float:
    """Read a number as the page writes it."""
    plain = text.replace("−", "-").replace(" × 10e", "e").replace(",", "")
    return float(plain[:-1]) / 100 if plain.endswith("%") else float(plain)


def test_the_page_needs_nothing_but_itself(paper: Path, bands: Path) -> None:
    for directory in (paper, bands):
        page = Page.of(directory)
        assert page.links
        assert all(link.startswith(("data:image/png;base64,", "#")) for link in page.links)
        assert {link[1:] for link in page.links if link.startswith("#")} == page.sections
        assert not page.tags & {"link", "iframe", "object"}
        assert not page.open_tags
        source = (directory / "report.html").read_text(encoding="utf-8")
        assert "@import" not in source
        assert "url(" not in source
        assert len(source) < 5e6


@pytest.mark.parametrize(
    ("fixture", "stems"),
    [
        ("paper", FIGURES),
        (
            "bands",
            {"frequencies", "array"}
            | {f"channel_0000_{name}" for name in WITHOUT_HELDOUT}
            | {f"channel_{number:04d}_{name}" for number in (2, 3) for name in WITHOUT_MAPS},
        ),
    ],
)
def test_every_figure_is_there_and_embedded(fixture: str, stems: set[str], request: pytest.FixtureRequest) -> None:
    directory: Path = request.getfixturevalue(fixture)
    files = {file.name: file.read_bytes() for file in (directory / "figures").iterdir()}
    assert set(files) == {f"{stem}.{form}" for stem in stems for form in ("png", "pdf")}
    assert all(files[f"{stem}.pdf"].startswith(b"%PDF") for stem in stems)
    images = Page.of(directory).images
    embedded = [base64.b64decode(str(image["src"]).partition(",")[2]) for image in images]
    assert sorted(embedded) == sorted(files[f"{stem}.png"] for stem in stems)
    assert all(content.startswith(b"\x89PNG") for content in embedded)
    assert all(image["alt"] for image in images)


def test_the_table_shows_the_numbers_of_the_summary(paper: Path) -> None:
    summary = json.loads((paper / "summary.json").read_text())
    shown = {row[-1]: row for row in Page.of(paper).rows if len(row) == 4}
    expected = {
        key: value
        for key, value in summary.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and key != "freq_hz"
    }
    assert set(shown) - {"Key in summary.json"} == set(expected)
    for key, value in expected.items():
        assert number(shown[key][1]) == pytest.approx(value, rel=0.006, abs=1e-12), key
        assert shown[key][0], f"nothing is said of {key}"
    assert shown["condition_number"][2] == "~3700"


def test_a_second_report_is_the_same_and_the_terminal_shows_its_numbers(
    paper: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {file: file.read_bytes() for file in [paper / "report.html", *(paper / "figures").iterdir()]}
    write_report(paper)
    assert {file: file.read_bytes() for file in before} == before
    out, _ = capsys.readouterr()
    summary = json.loads((paper / "summary.json").read_text())
    lines = {line.split()[0]: line.split() for line in out.splitlines() if "_" in line.partition(" ")[0]}
    for key in ("posterior_std_median", "condition_number", "ppd_z_std", "peak_rss_mb", "correlation_below_0.1"):
        assert number(lines[key][1]) == pytest.approx(summary[key], rel=0.006)
    assert lines["condition_number"][-1] == "~3700"
    assert out.splitlines()[-1] == f"Report: {paper / 'report.html'}"


def test_only_the_papers_experiments_have_its_column(bands: Path) -> None:
    assert "The paper, 150 MHz" not in Page.of(bands).text


def test_names_are_escaped(bands: Path) -> None:
    page = Page.of(bands)
    assert "Beam posterior: bands <&>" in page.text
    assert not page.tags & {"&", "&amp;"}


def test_many_channels_are_listed_and_three_are_drawn(bands: Path) -> None:
    page = Page.of(bands)
    assert "in 4 channels from 120 to 150 MHz" in page.text
    assert [row[0] for row in page.rows if re.fullmatch(r"\d+ MHz", row[0])] == [
        "120 MHz",
        "130 MHz",
        "140 MHz",
        "150 MHz",
    ]
    assert re.findall(r"Channel \d, \d+ MHz", page.text)[3:] == [  # the contents have them, too
        "Channel 0, 120 MHz",
        "Channel 2, 140 MHz",
        "Channel 3, 150 MHz",
    ]


def test_provenance_has_versions_checksums_seed_and_job(bands: Path) -> None:
    text = Page.of(bands).text
    data = next(path for path in json.loads((bands / "provenance.json").read_text())["sha256"])
    assert re.search(rf"{re.escape(data)}: [0-9a-f]{{64}}", text)
    assert re.search(r"numpy: \d", text)
    assert "seed: 0" in text
    assert 'kind = "flat"' in text


def test_the_incomplete_sky_is_warned_of(paper: Path, edited: Edit) -> None:
    def change(summary: dict[str, Any]) -> None:
        summary.update({"name": "incomplete sky", "flux_removed": 0.009, "warnings": ["Held-out χ² is 7e3."]})

    copy = edited(paper, change)
    drop_arrays(copy, *BULK)
    write_report(copy)
    page = Page.of(copy)
    assert "errors that are not its own" in page.text
    assert "Held-out χ² is 7 × 103." in page.text  # 10 to the third: the exponent is raised
    rows = {row[-1]: row for row in page.rows if len(row) == 4}
    assert rows["imag_max"][2] == "≲10e−3"
    assert rows["flux_removed"][1:3] == ["0.9%", "~1%"]
    assert rows["condition_number"][2] == ""


@pytest.mark.study
def test_absent_numbers_and_maps_are_done_without(paper: Path, edited: Edit) -> None:
    def change(summary: dict[str, Any]) -> None:
        for numbers in (summary, *summary["channels"]):
            for key in [key for key in numbers if re.match("ppd|heldout|beam|model_error|n_|wall|name|warn", key)]:
                del numbers[key]

    copy = edited(paper, change)
    drop_arrays(copy, "map_truth", "z_counts", "eigen_beams", "eigen_variances")
    write_report(copy)
    page = Page.of(copy)
    stems = {file.stem for file in (copy / "figures").iterdir()}
    assert stems == FIGURES - {"heldout_scores", "eigenbeams"}
    assert "No data were held out" in page.text
    assert "Beam posterior: edited" in page.text
    assert "the change from the model beam" in page.text
    assert {row[-1] for row in page.rows} >= {"posterior_std_median", "imag_max"}
    assert "ppd_z_std" not in page.text


def test_a_beam_that_predicts_worse_is_called_so(paper: Path, edited: Edit) -> None:
    def change(summary: dict[str, Any]) -> None:
        for numbers in (summary, *summary["channels"]):
            numbers.update(
                {
                    "heldout_chi2_noise_only": 9.0,
                    "heldout_chi2_unperturbed": 4.0,
                    "heldout_chi2_unperturbed_scaled": 3.0,
                }
            )

    copy = edited(paper, change)
    drop_arrays(copy, *BULK)
    write_report(copy)
    text = Page.of(copy).text
    assert "rises from 4.00 with the model beam" in text
    assert "no better than the model beam does" in text


def refused(directory: Path) -> str:
    with pytest.raises(InputError) as caught:
        write_report(directory)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_no_such_folder(tmp_path: Path) -> None:
    missing = tmp_path / "none"
    assert refused(missing) == f"{missing}: no such folder; name a folder written by 'hydrabeam infer'"


def test_folder_without_a_summary(tmp_path: Path) -> None:
    assert "summary.json: no such file" in refused(tmp_path)


def test_folder_without_a_posterior(paper: Path, edited: Edit) -> None:
    copy = edited(paper, lambda summary: None)
    (copy / "posterior.h5").unlink()
    assert "posterior.h5: no such file" in refused(copy)


@pytest.mark.parametrize(
    ("text", "said"), [("{", "cannot be read as JSON"), ("[1]", "is not a table"), ("\x00", "cannot be read as JSON")]
)
def test_summary_that_is_none(text: str, said: str, paper: Path, edited: Edit) -> None:
    copy = edited(paper, lambda summary: None)
    (copy / "summary.json").write_text(text)
    assert said in refused(copy)


def test_files_of_different_runs(paper: Path, edited: Edit) -> None:
    copy = edited(paper, lambda summary: summary["channels"].append({}))
    assert "has 2 channels, posterior.h5 has 1" in refused(copy)


def test_nothing_changes_where_it_fails(paper: Path, edited: Edit) -> None:
    copy = edited(paper, lambda summary: None)
    (copy / "report.html").write_text("an earlier report")
    drop_arrays(copy, "std")
    with pytest.raises(InputError, match="std: is missing"):
        write_report(copy)
    assert sorted(file.name for file in copy.iterdir()) == ["posterior.h5", "report.html", "summary.json"]
    assert (copy / "report.html").read_text() == "an earlier report"


def test_a_place_that_cannot_be_written(paper: Path, edited: Edit) -> None:
    copy = edited(paper, lambda summary: None)
    drop_arrays(copy, *BULK)
    (copy / "report.html").mkdir()
    assert "report.html: cannot be written" in refused(copy)
    assert not [file for file in copy.iterdir() if "partial" in file.name]


def test_its_files_are_part_of_the_result(paper: Path) -> None:
    listed = read_manifest(paper)
    assert listed is not None
    assert {"report.html", "posterior.h5"} < listed.keys()
    assert any(name.startswith("figures/") for name in listed)
    assert find_strangers(paper) == []
