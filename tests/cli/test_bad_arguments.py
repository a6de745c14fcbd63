"""Job files, folders and command lines that cannot be used: one line, exit status 2, and nothing changed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from mpi4py import MPI

from hydrabeam_mpi.cli import main
from tests.cli.conftest import OnRoot, Workspace, refusal

pytestmark = pytest.mark.mpi

JOB_FILES = {
    "missing": (None, "cannot be read (No such file or directory); check the path"),
    "not TOML": ("[data\n", "is not a TOML file"),
    "not text": ("\udcff", "is not text in UTF-8"),
    "empty": ("", "[data]: is missing; add it"),
}


@pytest.mark.parametrize("name", JOB_FILES)
def test_job_file_that_is_none(
    name: str, workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    text, words = JOB_FILES[name]
    job = workspace.folder / "job.toml"
    on_root(lambda: text is not None and job.write_text(text, errors="surrogateescape"))
    assert main(["infer", str(job), "-o", str(workspace.folder / "result")]) == 2
    line = refusal(capfd, comm)
    assert line.startswith(f"hydrabeam: error: {job}: {words}")


def make_result(folder: Path) -> None:
    folder.mkdir()
    (folder / "provenance.json").write_text("{}")
    (folder / "kept").write_text("precious")


def make_other_folder(folder: Path) -> None:
    folder.mkdir()
    (folder / "kept").write_text("precious")


def make_file(folder: Path) -> None:
    folder.write_text("precious")


OUTPUTS = {
    "existing": (make_result, "out", [], "exists already; choose another folder or add --overwrite"),
    "existing file": (make_file, "out", ["--overwrite"], "is not a folder; choose another name"),
    "existing folder of something else": (make_other_folder, "out", ["--overwrite"], "is not an earlier result"),
    "below a file": (
        make_file,
        "out/below/result",
        [],
        "cannot be written, as {folder}/out is a file; choose a folder",
    ),
    "nowhere to write": (lambda _: None, "/proc/result", [], "cannot be written (No such file or directory); choose"),
    "too long a name": (lambda _: None, "n" * 300, [], "cannot be written (File name too long); choose a folder"),
}


@pytest.mark.parametrize("name", OUTPUTS)
def test_output_that_cannot_be(
    name: str, workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    make, out, options, words = OUTPUTS[name]
    job = on_root(lambda: workspace.job())
    on_root(lambda: make(workspace.folder / "out"))
    before = on_root(lambda: sorted(workspace.folder.rglob("*")))
    assert main(["infer", str(job), "-o", str(workspace.folder / out), *options]) == 2
    line = refusal(capfd, comm)
    assert f"{workspace.folder / out}: -o: {words.format(folder=workspace.folder)}" in line
    assert on_root(lambda: sorted(workspace.folder.rglob("*"))) == before


def test_output_that_holds_the_input(
    workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    job = on_root(lambda: workspace.job())
    assert main(["infer", str(job), "-o", str(workspace.simulated), "--overwrite"]) == 2
    line = refusal(capfd, comm)
    assert line.endswith("result: -o: holds data.uvh5, which the job reads; choose another folder")
    assert workspace.data.exists()


@pytest.mark.parametrize("there", [True, False])
def test_report_of_what_is_no_result(
    there: bool, common_tmp_path: Path, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = common_tmp_path if there else common_tmp_path / "missing"
    assert main(["report", str(folder)]) == 2
    line = refusal(capfd, comm)
    assert str(folder) in line
    assert "; name a folder written by 'hydrabeam infer'" in line


def test_init_of_what_is_no_data(
    workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    on_root(lambda: workspace.write("text.dat", "nothing of the kind\n"))
    assert main(["init", str(workspace.folder / "text.dat")]) == 2
    line = refusal(capfd, comm)
    assert "text.dat: not a uvh5 file; give a uvh5" in line


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ([], "the following arguments are required: COMMAND; see 'hydrabeam --help'"),
        (["infre"], "see 'hydrabeam --help'"),
        (["infer"], "required: JOB.toml, -o/--output; see 'hydrabeam infer --help'"),
        (["infer", "job.toml", "-o", "out", "--overwirte"], "unrecognized arguments: --overwirte"),
    ],
)
def test_command_line(words: list[str], complaint: str, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(words)
    line = refusal(capfd, comm)
    assert complaint in line


def copied(workspace: Workspace) -> Path:
    """Copy the simulated result, so that a test may lose it."""
    shutil.copytree(workspace.simulated, workspace.folder / "sim1")
    return workspace.folder / "sim1"


@pytest.mark.parametrize(
    ("job", "files", "words"),
    [
        ("job.toml", "sim*/data.uvh5", "sim1: -o: holds data.uvh5, which the job reads"),
        ("job.toml", "link.uvh5", "sim1: -o: holds link.uvh5, which the job reads"),
        ("sim1/amended.toml", "elsewhere.uvh5", "sim1: -o: holds elsewhere.uvh5, which the job reads"),
        ("sim1/amended.toml", "../elsewhere.uvh5", "sim1: -o: holds amended.toml, which the job reads"),
        ("job.toml", "elsewhere.uvh5", "holds what the earlier result did not, so it is not replaced: notes (added)"),
    ],
)
def test_overwrite_takes_nothing_that_is_needed(
    job: str, files: str, words: str, workspace: Workspace, on_root: OnRoot, comm: MPI.Comm,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def prepare() -> list[Path]:
        sim1 = copied(workspace)
        (workspace.folder / "link.uvh5").symlink_to(sim1 / "data.uvh5")
        for folder in (workspace.folder, sim1):
            shutil.copy(workspace.data, folder / "elsewhere.uvh5")
        if "elsewhere" in files and job == "job.toml":
            (sim1 / "elsewhere.uvh5").unlink()
            (sim1 / "notes").touch()
        workspace.job({"data.files": [files]}, job)
        return sorted(workspace.folder.rglob("*"))

    before = on_root(prepare)
    arguments = ["infer", str(workspace.folder / job), "-o", str(workspace.folder / "sim1"), "--overwrite"]
    assert main(arguments) == 2
    assert words in refusal(capfd, comm)
    assert on_root(lambda: sorted(workspace.folder.rglob("*"))) == before


def test_git_is_no_result(
    workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    def prepare() -> Path:
        subprocess.run(["git", "init", "--quiet", workspace.folder / "work"], check=True)
        (workspace.folder / "work" / ".git" / "provenance.json").write_text("{}")
        return workspace.job()

    job = on_root(prepare)
    out = workspace.folder / "work" / ".git"
    assert main(["infer", str(job), "-o", str(out), "--overwrite"]) == 2
    assert f"{out}: -o: is not an earlier result (it has no manifest.json of one)" in refusal(capfd, comm)
    assert on_root(lambda: (out / "HEAD").exists())
