"""Two nights, the first of which has been fitted once for all tests."""

from __future__ import annotations

import pytest

from tests.api.nights import Nights


@pytest.fixture(scope="session")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Nights:
    return Nights.make(tmp_path_factory.mktemp("nights"))
