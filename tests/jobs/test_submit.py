"""The batch scripts of the studies: their bodies run with the scheduler's variables set.

One is run to its end; of the others it is looked at what they call.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hydrabeam_mpi.terminal.command_line import make_parser

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "jobs").glob("*/submit.slurm"))
VARIABLES = {"SLURM_NTASKS": "2", "SLURM_CPUS_PER_TASK": "1", "SLURM_ARRAY_TASK_ID": "7"}
PBS = ROOT / "jobs/paper/submit.pbs"
SRUN = """#!/usr/bin/env bash
# Starts what srun would, and writes down how it was called.
echo "srun $*" >>"$CALLS"
while [[ $1 == --* ]]; do shift; done
exec "$@"
"""
REAL = f"""#!/usr/bin/env bash
exec {sys.executable} -m hydrabeam_mpi "$@"
"""
TINY = """
[data.simulate]
array = { hex = [1, 2] }
n_times = 2
[sky]
n_sources = 20
[basis]
n_modes = 6
k_max = 3
m_max = 1
[output]
draws = 0
"""
NOTED = """#!/usr/bin/env bash
echo "hydrabeam $*" >>"$CALLS"
case $1 in
infer | loop)
    mkdir -p "$4"
    touch "$4/manifest.json"
    ;;
esac
"""
OTHER = """#!/usr/bin/env bash
echo "${0##*/} $*" >>"$CALLS"
[[ $1 != --write ]] || { mkdir -p "$2" && touch "$2/job.toml"; }
"""


def executable(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """Return a copy of the jobs, beside stand-ins for the scheduler and the programs."""
    shutil.copytree(ROOT / "jobs", tmp_path / "jobs")
    executable(tmp_path / ".venv/bin/srun", SRUN)
    executable(tmp_path / ".venv/bin/hydrabeam", NOTED)
    (tmp_path / ".venv/bin/activate").write_text(f"PATH={tmp_path}/.venv/bin:$PATH\n")
    for name in ("study_joint_sky", "check_beams_agree"):
        executable(tmp_path / "tools" / name, OTHER)
    return tmp_path


def submit(script: Path, repository: Path) -> list[list[str]]:
    """Run the body of a script; return what was called, word by word."""
    calls = repository / "calls"
    calls.unlink(missing_ok=True)
    environment = {**os.environ, **VARIABLES, "CALLS": str(calls)}
    path = repository / script.relative_to(ROOT)
    done = subprocess.run(["bash", path], cwd=repository, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [line.split() for line in calls.read_text().splitlines()]


def test_to_the_end(repository: Path) -> None:
    executable(repository / ".venv/bin/hydrabeam", REAL)
    (repository / "jobs/paper/job.toml").write_text(TINY)
    submit(ROOT / "jobs/paper/submit.slurm", repository)
    assert (repository / "out/paper/report.html").exists()


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.parent.name)
def test_body(script: Path, repository: Path) -> None:
    calls = submit(script, repository)
    steps = [call for call in calls if call[0] == "srun"]
    assert steps
    assert all(call[1:4] == ["--kill-on-bad-exit=1", "--cpus-per-task=1", "hydrabeam"] for call in steps)
    for call in calls:
        if call[0] == "hydrabeam":
            options = make_parser().parse_args(call[1:])
            assert options.command in ("infer", "report", "sample")
            if options.command == "infer":
                assert (repository / options.job).exists()
    # Submitted again, what is done is not done again: but for chains, which go on.
    again = [call for call in submit(script, repository) if call[0] == "srun"]
    assert [call[4] for call in again] == ["sample"] * ("sample" in steps[0])


def test_body_for_pbs(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Started as PBS does: in the home folder, with a file of nodes that has a line a rank."""
    (repository / "nodes").write_text("one\none\ntwo\n")
    executable(
        repository / ".venv/bin/mpiexec", SRUN.replace("srun", "mpiexec").replace("$1 == --*", "$1 != hydrabeam")
    )
    monkeypatch.setenv("PBS_NODEFILE", str(repository / "nodes"))
    monkeypatch.setenv("PBS_O_WORKDIR", str(repository))
    calls = submit(PBS, repository)
    assert calls[0] == ["mpiexec", "-n", "3", "hydrabeam", "infer", "jobs/paper/job.toml", "-o", "out/paper"]
    assert calls[-1] == ["hydrabeam", "report", "out/paper"]
    assert [call[1] for call in submit(PBS, repository)] == ["report"]


def test_array_takes_one_channel_each(repository: Path) -> None:
    submit(ROOT / "jobs/hera_350/submit.slurm", repository)
    job = (repository / "out/hera_350/jobs/channel_0007.toml").read_text()
    assert 'freqs = ["128.5 MHz"]' in job
    assert '[beam]\nfrequency = "scale"\n' in job
    made = repository / "out/hera_350/jobs/channel_0007.toml"
    check = (
        "import sys; from pathlib import Path; from hydrabeam_mpi.config import load_job; load_job(Path(sys.argv[1]))"
    )
    subprocess.run([sys.executable, "-c", check, made], check=True)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.parent.name)
def test_asks_for_what_the_body_uses(script: Path) -> None:
    text = script.read_text()
    asked = {line.split("=")[0].split()[-1] for line in text.splitlines() if line.startswith("#SBATCH")}
    assert {"--nodes", "--ntasks", "--cpus-per-task", "--mem-per-cpu", "--time"} <= asked
    assert "# module load " in text
    assert ("--array" in asked) == ("SLURM_ARRAY_TASK_ID" in text)


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="shellcheck is not installed")
def test_shellcheck() -> None:
    done = subprocess.run(["shellcheck", *SCRIPTS, PBS], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
