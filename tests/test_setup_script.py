"""What `tools/setup.sh` takes from GNU's coreutils, and does without them, as on macOS."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = """
set -euo pipefail
. tools/setup.sh
cd /
absolute usr/../venv
absolute /tmp/venv
printf abc | checksum
timeout --foreground --kill-after=30 60 bash -c 'echo "$1"; exit 3' _ "two words" || echo "status $?"
timeout --kill-after=30 1 sleep 60 || echo ended
"""


@pytest.mark.parametrize("has_coreutils", [True, False])
def test_with_and_without_coreutils(has_coreutils: bool, tmp_path: Path) -> None:
    path = None
    if not has_coreutils:
        for name in ("bash", "perl", "shasum", "sleep"):
            found = shutil.which(name)
            if found is None:
                pytest.skip(f"no {name} here")
            (tmp_path / name).symlink_to(found)
        path = {"PATH": str(tmp_path)}
    bash = shutil.which("bash")
    assert bash is not None
    done = subprocess.run(
        [bash, "-c", SCRIPT], cwd=ROOT, env=path, capture_output=True, text=True, timeout=60, check=False
    )
    relative, absolute, checksum, *rest = done.stdout.splitlines()
    assert Path(relative).resolve() == Path("/venv")
    assert absolute == "/tmp/venv"
    assert checksum.split()[0] == hashlib.sha256(b"abc").hexdigest()
    assert rest == ["two words", "status 3", "ended"]
