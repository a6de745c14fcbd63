from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.finite import check_finite

WHERE = "channel 3 (131 MHz)"


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ({"one": 1.0, "mean": np.array([1, np.nan, np.inf])}, "mean: 2 of 3 numbers are not finite"),
        ({"mean": np.array([1, complex(0, np.inf)])}, "mean: 1 of 2 numbers are not finite"),
        ({"log_evidence": np.float64(-np.inf)}, "log_evidence: is not finite"),
        ({"rounds": [{"n": 1}, {"n": 2, "std": float("nan")}]}, "rounds std: is not finite"),
    ],
)
def test_the_first_that_is_not_is_named(numbers: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError) as raised:
        check_finite(WHERE, numbers, "mend it")
    assert str(raised.value) == f"{WHERE}: {expected}, so nothing is written; mend it"


def test_others_pass() -> None:
    check_finite(WHERE, {"a": [1, 2.5, None, "nan", True], "b": np.arange(3), "c": {"d": 1e308}, "e": ()}, "mend it")
