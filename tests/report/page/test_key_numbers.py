"""Numbers as they are written, and what is said of them."""

from __future__ import annotations

from typing import Any

import pytest

from hydrabeam_mpi.report.page.key_numbers import Kind, as_text, format_value, table
from hydrabeam_mpi.report.page.parts import as_html
from hydrabeam_mpi.report.page.words import heldout_words, megahertz
from hydrabeam_mpi.result.told import warnings_of


@pytest.mark.parametrize(
    ("value", "kind", "text"),
    [
        (4.942e-6, "number", "4.94e-6"),
        (-1.5e7, "number", "-1.50e7"),
        (1599.56, "number", "1,600"),
        (122068.1, "number", "122,068"),
        (1.3640, "number", "1.36"),
        (43.53, "number", "43.5"),
        (0.00230, "number", "0.00230"),
        (0, "number", "0"),
        (9.996, "number", "10.00"),
        (float("inf"), "number", "inf"),
        (19980, "count", "19,980"),
        (0.971, "percent", "97.1%"),
        (0.99999927, "percent", "99.999927%"),
        (0.99935, "percent", "99.935%"),
        (1.0, "percent", "100.0%"),
        (0.0088, "percent", "0.88%"),
        (0.0, "percent", "0%"),
        (-0.32, "percent", "-32.0%"),
    ],
)
def test_format(value: float, kind: Kind, text: str) -> None:
    assert format_value(value, kind) == text


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("4.94e-6", "4.94 × 10<sup>−6</sup>"),
        ("~4.5e-6", "~4.5 × 10<sup>−6</sup>"),
        ("≲1e-5", "≲10<sup>−5</sup>"),
        ("-1.50e7 < 2", "−1.50 × 10<sup>7</sup> &lt; 2"),
        ("file-1e5.h5 v2.1e3", "file-1e5.h5 v2.1e3"),
    ],
)
def test_powers_of_ten_in_html(text: str, html: str) -> None:
    assert as_html(text) == html


def test_the_table_takes_what_is_there() -> None:
    numbers: dict[str, Any] = {
        "ranks": 2,
        "condition_number": 1600.0,
        "phases_s": {"solve": 1.0},
        "log_evidence": None,
        "a_new_number": 0.5,
        "freq_hz": 131e6,
    }
    groups = table(numbers, "job")
    assert [[row.key for row in rows] for rows in groups.values()] == [
        ["condition_number"],
        ["ranks"],
        ["a_new_number"],
    ]
    assert list(groups)[-1] == "Other"


@pytest.mark.parametrize(
    ("name", "paper"), [("paper", "≲1e-5"), ("incomplete sky", "≲1e-3"), ("incomplete_sky", "≲1e-3"), ("mine", "")]
)
def test_the_papers_result_stands_beside_its_own_experiments(name: str, paper: str) -> None:
    (row,) = table({"imag_max": 1e-3}, name)["Beam on the one-degree grid"]
    assert row.paper == paper


def test_columns_of_the_terminal_table_are_aligned() -> None:
    text = as_text(table({"condition_number": 1600.0, "ppd_z_std": 1.36, "ranks": 2}, "paper"))
    first, *rest = text.splitlines()
    end = first.index("value") + len("value")
    assert [line[:end].split()[-1] for line in rest] == ["1,600", "1.36", "2"]
    assert all(line[end : end + 2] == "  " for line in rest)
    assert first.endswith("the paper, 150 MHz")


def test_heldout_words_compare_before_and_after() -> None:
    words = heldout_words(
        {
            "heldout_n": 19980.0,
            "heldout_chi2_noise_only": 1.03,
            "heldout_chi2_unperturbed": 1952.0,
            "heldout_rms_jy": 0.0173,
            "heldout_rms_jy_unperturbed": 0.574,
            "heldout_rms_jy_data": 22.3,
        }
    )
    assert "On 19,980 held-out visibilities the reduced χ² falls from 1,952" in words
    assert "to 1.03 with the inferred beam" in words
    assert "rms changes from 0.574 to 0.0173 Jy, of 22.3 Jy" in words
    assert words.endswith("to the noise.")
    assert heldout_words({"heldout_chi2_noise_only": 1.0}) == ""


@pytest.mark.parametrize(
    ("after", "predictive", "scaled", "verdict"),
    [
        (1.05, 0.99, 900.0, "to the noise"),
        (1.8, 1.8, 900.0, "detectable, but of the order of what the posterior expects"),
        (676.0, 1.19, 900.0, "detectable, but of the order of what the posterior expects"),
        (676.0, 1.01, 900.0, "as well as its standard deviations say"),
        (400.0, 300.0, 900.0, "far above what the posterior expects"),
        (400.0, None, 900.0, "far above what the posterior expects"),
        (950.0, 1.0, 900.0, "no better than the model beam"),
    ],
)
def test_verdicts_hold_against_the_scaled_model(
    after: float, predictive: float | None, scaled: float, verdict: str
) -> None:
    numbers = {
        "heldout_chi2_noise_only": after,
        "heldout_chi2_predictive": predictive,
        "heldout_chi2_unperturbed": 1000.0,
        "heldout_chi2_unperturbed_scaled": scaled,
    }
    assert verdict in heldout_words(numbers).rsplit("right gives 1. ")[-1]


def test_page_and_warnings_agree() -> None:
    """What the page calls far above the posterior is warned of, and nothing else."""
    known = {"heldout_amplitude_unperturbed": 1.0, "negative_fraction": 0.0, "imag_max": 0.0, "freq_hz": 1e8}
    for noise_only, predictive in ((676.0, 1.19), (1.5, 1.4), (30.0, 2.1), (676.0, 600.0), (1.0, 1.0)):
        numbers = {
            "heldout_chi2_noise_only": noise_only,
            "heldout_chi2_predictive": predictive,
            "heldout_chi2_unperturbed": 1e5,
            "heldout_chi2_unperturbed_scaled": 1e5,
        }
        assert ("far above" in heldout_words(numbers)) == bool(warnings_of([known | numbers]))


@pytest.mark.parametrize(("freq", "text"), [(131e6, "131 MHz"), (100.1953125e6, "100.1953 MHz"), (7.5e7, "75 MHz")])
def test_frequencies(freq: float, text: str) -> None:
    assert megahertz(freq) == text
