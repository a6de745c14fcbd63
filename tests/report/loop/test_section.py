"""What the loop found, on the page and in its figures."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import matplotlib
import pytest
from markupsafe import Markup

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.report.document import write_report
from hydrabeam_mpi.report.loop.record import VERDICTS
from hydrabeam_mpi.report.loop.section import loop_answer, loop_sections
from hydrabeam_mpi.report.loop.words import round_words
from hydrabeam_mpi.report.page.parts import set_page
from hydrabeam_mpi.report.page.style import STYLE, Drawing, render
from hydrabeam_mpi.setup.findings import Finding
from tests.report import loops
from tests.report.conftest import BULK, Edit, drop_arrays
from tests.report.test_document import Page

Entry = dict[str, Any]
MADE_UP = {"consistent": loops.consistent, "explained": loops.explained, "unexplained": loops.unexplained}
ALWAYS = {"loop_ranking", "loop_residuals"}
OF_ROUNDS = ALWAYS | {"loop_heldout", "loop_parameters_1"}


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    """Draw as the report does."""
    with matplotlib.rc_context(STYLE):
        yield


@pytest.fixture(scope="module")
def reported(paper: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results with the loops that are made up, and their reports."""
    folders = {}
    for name, make in MADE_UP.items():
        folders[name] = folder = tmp_path_factory.mktemp(name)
        for file in ("posterior.h5", "summary.json"):
            shutil.copy(paper / file, folder)
        drop_arrays(folder, *BULK)
        (folder / "loop.json").write_text(json.dumps(make()))
        write_report(folder)
    return folders


def whole(loop: Entry, place: Callable[[Drawing], Markup] = lambda drawing: Markup()) -> str:
    """What the loop adds to a page, as HTML."""
    page = set_page("A loop", loop_answer(loop, Markup(), []), loop_sections(loop, place), "")
    return page.partition("<body>")[2].partition("<dialog")[0]


def section(loop: Entry) -> tuple[str, dict[str, Drawing]]:
    """The loop's HTML with all figures rendered."""
    drawings: dict[str, Drawing] = {}

    def place(drawing: Drawing) -> Markup:
        assert drawing.name not in drawings
        assert set(render(drawing.figure)) == {"png", "pdf"}
        drawings[drawing.name] = drawing
        return Markup()

    return whole(loop, place), drawings


@pytest.mark.parametrize(
    ("name", "stems"),
    [
        ("consistent", ALWAYS),
        ("explained", OF_ROUNDS | {"loop_parameters_2"}),
        ("unexplained", OF_ROUNDS | {"loop_singular_values", "loop_structures"}),
    ],
)
def test_the_page_begins_with_the_loop(name: str, stems: set[str], reported: dict[str, Path]) -> None:
    page = Page.of(reported[name])
    said = MADE_UP[name]()["sentence"].replace("chi^2", "χ²").replace("->", "→")
    files = {file.stem for file in (reported[name] / "figures").iterdir()}
    assert {stem for stem in files if stem.startswith("loop_")} == stems
    assert not page.open_tags
    assert all(image["alt"] for image in page.images)
    assert (
        page.text.index(said)
        < page.text.index("The residual in numbers")
        < page.text.rindex("Key numbers of the amended")
    )


def test_the_terminal_shows_the_verdict(paper: Path, edited: Edit, capsys: pytest.CaptureFixture[str]) -> None:
    folder = edited(paper, lambda summary: None)
    drop_arrays(folder, *BULK)
    for told, said in (({}, "ended with the verdict 'unexplained'"), ({"sentence": "So it is."}, "\nSo it is.\n")):
        (folder / "loop.json").write_text(json.dumps({"verdict": "unexplained", **told}))
        write_report(folder)
        assert said in capsys.readouterr().out


def test_a_result_without_a_loop_has_no_such_section(paper: Path) -> None:
    assert "amended model" not in Page.of(paper).text


def test_the_table_of_rounds(reported: dict[str, Path]) -> None:
    rows = Page.of(reported["explained"]).rows
    first = next(row for row in rows if row[:2] == ["1", "antenna gains"])
    assert first[2:] == ["8,312", "2.1%", "10.9 → 2.25", "11.4 → 2.31", "9.10 → 4.20", "antenna positions", "–"]
    second = next(row for row in rows if row[:2] == ["2", "missing sources"])
    assert second[2:] == [
        "905",
        "34.0%",
        "2.25 → 0.990",
        "2.31 → 1.03",
        "– → –",
        "catalogue flux",
        "catalogue flux, smooth and diffuse",
    ]
    told = rows[rows.index(first) + 1][1]
    assert "0.041 ± 0.0011" in told
    assert "χ² 11.4 → 2.31" in told
    assert "16 parameters, 14.2 effective. The held-out data confirm it at 57.3σ." in told


def test_what_was_taken_back_is_not_called_confirmed() -> None:
    words = [round_words({"sentence": "Gains.", "heldout_sigma": 9.0, "revoked": revoked}) for revoked in (False, True)]
    assert words == ["Gains. The held-out data confirm it at 9.0σ.", "Gains."]


def test_the_table_of_held_out_data_in_jy(reported: dict[str, Path]) -> None:
    page = Page.of(reported["unexplained"])
    in_jy, others = (row[1:] for row in page.rows if row[0] == "all" and len(row) in (7, 5))
    assert in_jy == ["12.1", "10.2", "9.40", "9.10", "4.20", "3.90"]
    assert others == ["43.4% → 88.0%", "11.4 → 2.31", "11.9 → 2.60", "−91,000 → −24,000"]
    assert not any(row[0] == "all" and len(row) == 7 for row in Page.of(reported["explained"]).rows)


def test_the_table_of_parameters_has_those_farthest_from_zero(reported: dict[str, Path]) -> None:
    rows = Page.of(reported["explained"]).rows
    assert ["source 1 right ascension", "all", "52.310", "0.0200", "deg", "2,616"] in rows
    of_23 = [row for row in rows if row[0].startswith("antenna 23")]
    assert [row[1] for row in of_23] == ["150 MHz", "150 MHz"]
    assert sum(row[0].startswith("antenna ") and len(row) == 6 for row in rows) == 12


def test_what_was_left_out(reported: dict[str, Path]) -> None:
    page = Page.of(reported["unexplained"])
    assert ["diffuse, smooth", "55.1", "held-out χ² does not fall: 2.31 to 2.40"] in page.rows
    assert ["leakage", "needs cross-polarisations; the files have ee alone"] in page.rows
    assert any(row[0] == "common flux scale" for row in page.rows)
    assert ["conjugated", "15,321", "12.0%"] in page.rows
    assert "prepare 1.24 s, attribution 12.5 s" in page.text


def test_where_it_lives(reported: dict[str, Path]) -> None:
    page = Page.of(reported["unexplained"])
    assert "4 of 20 times (LST 2.29-2.58 h)" in page.text
    rows = {tuple(row[:2]): row[2:] for row in page.rows if len(row) == 5}
    assert rows["antennas", "concentrated"] == ["2 of 8", "30.1", "antenna 11 (41.0%), antenna 24 (29.0%)"]
    assert rows["lengths", "even"] == ["3 of 5", "0.4", "–"]
    assert ["redundant group 3 (14.6 m East, 0.0 m North)", "7.70", "44.0", "40.0%"] in page.rows


def test_numbers_of_the_residual_before_and_after(reported: dict[str, Path]) -> None:
    page = Page.of(reported["explained"])
    row = next(row for row in page.rows if row[0].startswith("reduced χ², noise"))
    assert row[1:] == ["11.4", "987", "1.03", "2.8"]
    assert "of 173 looks" in page.text


def without(value: Any, group: int, null: bool, seen: Iterator[int]) -> Any:
    """Leave out every eighth key of a record, or make it null; the groups 0 to 7 have all keys."""
    if isinstance(value, list):
        return [without(inner, group, null, seen) for inner in value]
    if not isinstance(value, dict):
        return value
    kept = {}
    for key, inner in value.items():
        inside = without(inner, group, null, seen)
        if key == "verdict" or next(seen) % 8 != group:
            kept[key] = inside
        elif null:
            kept[key] = None
    return kept


@pytest.mark.parametrize("null", [False, True])
@pytest.mark.parametrize("group", range(8))
def test_any_key_may_be_missing_or_null(group: int, null: bool) -> None:
    loop = without(loops.unexplained(), group, null, count())
    html = whole(loop, lambda drawing: Markup("<p>{}</p>").format(drawing.caption))
    assert "So it ended" in html or "ended with the verdict" in html
    assert "nan" not in html.lower()


@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_verdict_alone_is_enough(verdict: str) -> None:
    html, drawings = section({"verdict": verdict})
    assert f"ended with the verdict '{verdict}'" in html.replace("&#39;", "'")
    assert not drawings


@pytest.mark.study
def test_large_numbers_fit() -> None:
    loop = loops.explained()
    loop["rounds"] *= 2
    for place, one in enumerate(copy.deepcopy(loop["rounds"])):
        loop["rounds"][place] = one
        one["heldout_after"], one["log_bayes_factor"] = 10.0 ** (8 - place), 3e9
        one["ranking"][0]["log_bayes_factor"], one["ranking"][-1]["log_bayes_factor"] = 3e9, -5e4
        one["residual"]["overall"]["sigma"] = 1e9
    loop["error_before"] = loop["rounds"][0]["heldout_before"] = 4.5e9
    html, drawings = section(loop)
    assert "4.50 × 10<sup>9</sup>" in html
    assert len(drawings) == 3 + 4


@pytest.mark.parametrize("text", ["{", "[1]", '{"verdict": "perhaps"}', "{}", "[" * 100_000])
def test_a_loop_that_is_none(text: str, paper: Path, edited: Edit) -> None:
    folder = edited(paper, lambda summary: None)
    (folder / "loop.json").write_text(text)
    with pytest.raises(InputError, match=r"loop\.json"):
        write_report(folder)


@pytest.mark.parametrize(
    "damage",
    [
        {"verdict": ["explained"]},
        {"rounds": 5},
        {"conventions": "none"},
        {"residual": {"axes": [1], "overall": "x"}},
    ],
)
def test_damaged_values_are_told_in_one_line(damage: dict[str, Any], paper: Path, edited: Edit) -> None:
    folder = edited(paper, lambda summary: None)
    drop_arrays(folder, *BULK)
    (folder / "loop.json").write_text(json.dumps(loops.unexplained() | damage))
    before = sorted(folder.rglob("*"))
    with pytest.raises(InputError, match=r"loop\.json: .*; run 'hydrabeam loop' again"):
        write_report(folder)
    assert sorted(folder.rglob("*")) == before


def test_what_follows_the_model_is_listed() -> None:
    loop = loops.unexplained()
    loop["residual"]["coherent"] = [
        {"kind": "changes of gains", "what": "antenna 8 after LST 3.21 h", "sigma": 7.3, "n": 437}
    ]
    html = whole(loop)
    assert "changes of gains, the most significant of 437" in html
    assert "antenna 8 after LST 3.21 h" in html


def test_parameters_that_are_not_told_are_counted() -> None:
    loop = loops.explained()
    loop["rounds"][0]["parameters_not_told"] = [{"name": "a"}, {"name": "b"}]
    assert "2 more that the data do not tell" in whole(loop)


def test_what_is_wrong_with_the_data_is_told_with_its_remedy() -> None:
    finding = {"what": "a bad integration", "where": "JD 2459866.2, held out", "why": "it is <wild>"}
    finding["remedy"] = "exclude_times = [[2459866.1, 2459866.3]] in [data]"
    told = whole(loops.explained() | {"health": [finding]})
    line = "A bad integration (JD 2459866.2, held out): it is &lt;wild&gt;. Remedy: exclude_times = "
    assert f"<li>Of the data themselves: {line}[[2459866.1, 2459866.3]] in [data].</li>" in told
    assert "Of the data themselves" not in whole(loops.explained())
    line = Finding.of_record(finding).line
    answer = loop_answer(loops.explained() | {"health": [finding]}, Markup(), [line, "The beam is negative."])
    assert answer.warnings == [f"Of the data themselves: {line}", "The beam is negative."]
