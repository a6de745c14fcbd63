"""``python -m tests.faults.prepare FOLDER [quick]`` makes the good files there, and what comes of each."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.faults.cases import make_answers
from tests.faults.samples import make

if __name__ == "__main__":
    make(Path(sys.argv[1]).resolve())
    make_answers(Path(sys.argv[1]).resolve(), quick=sys.argv[2:] == ["quick"])
