"""A process that runs cases one after the other: numbers in on standard input, verdicts out as lines of JSON.

``python -m tests.faults.worker SAMPLES SEED``
"""

from __future__ import annotations

import json
import os
import resource
import sys
from pathlib import Path
from typing import Any

from tests.faults.cases import as_table, run_case

MEMORY = 8 << 30
"""Bytes that a run may ask for: more than ten times what the good files take, so that a size that is not checked shows
as a failure and not as a machine out of memory."""


def work(samples: Path, seed: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    answers = os.fdopen(os.dup(1), "w")

    def tell(table: dict[str, Any]) -> None:
        print(json.dumps(table), file=answers, flush=True)

    for line in sys.stdin:
        verdict = run_case(
            samples, seed, int(line), begun=lambda target, damage: tell({"target": target, "damage": damage})
        )
        tell(as_table(verdict))


if __name__ == "__main__":
    work(Path(sys.argv[1]), int(sys.argv[2]))
