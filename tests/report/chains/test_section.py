"""The page of a folder of chains: at any moment, with what there is by then."""

from __future__ import annotations

from pathlib import Path

import pytest

from hydrabeam_mpi.report.document import write_report
from tests.report.chains.made import new_chains
from tests.sampling.made import add, new_store

FIGURES = ("chains_ess", "chains_traces", "chains_uncertainty", "chains_degeneracy")


def test_the_page_shows_all_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new_chains(tmp_path, n_chains=2, n_draws=200)
    write_report(tmp_path)
    page = (tmp_path / "report.html").read_text()
    for name in FIGURES:
        assert (tmp_path / "figures" / f"{name}.pdf").exists()
        assert f'<figure id="{name}">' in page
    for words in (
        "Do the chains agree?",
        "of each of 2 chains",
        "flux[Fornax A]",
        "The beam and all else, 120 MHz",
        "All channels",
        "<td>120 MHz</td>",
        "<td>130 MHz</td>",
    ):
        assert words in page
    assert "nan" not in page.split("base64")[0]
    assert "all draws are there" in capsys.readouterr().out


def test_a_chain_that_has_just_begun_has_a_page_too(tmp_path: Path) -> None:
    store = new_store(tmp_path, chains=2, draws=50, warm_up=3)
    write_report(tmp_path)
    assert "0 of each of 0 chains, after 3 of warm-up" in (tmp_path / "report.html").read_text()
    with store.writer(0) as writer:
        add(writer, 0, 2)
        write_report(tmp_path)
        add(writer, 0, 2)
        write_report(tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "1 of each of 1 chains" in page
    assert "<figure" not in page
