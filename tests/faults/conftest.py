"""The good files, once for all tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.campaign import make_samples


@pytest.fixture(scope="session")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_samples(tmp_path_factory.mktemp("samples"))
