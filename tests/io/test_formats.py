"""Files say their version, units and names; old versions are read, and unknown ones are refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import h5py
import jsonschema
import pytest

import hydrabeam_mpi as hb

JOB: dict[str, Any] = {
    "data": {
        "simulate": {
            "array": {"hex": [2, 3]},
            "n_times": 24,
            "nsamples": 1.0,
            "perturb": {"stretch": [1.02, 1.02], "sidelobe": 0.0},
            "effects": [{"kind": "antenna_gains", "parameters": {"antenna 3 ln amplitude": 0.1}}],
        }
    },
    "sky": {"n_sources": 100},
    "beam": {"source": "airy", "diameter": 14.0},
    "basis": {"n_modes": 100, "k_max": 24, "m_max": 8},
    "output": {"draws": 2},
}
LOADERS: dict[str, Callable[[Path], Any]] = {
    "posterior.h5": hb.load_posterior,
    "truth.h5": hb.load_truth,
    "loop.json": hb.load_loop,
    "chains.json": lambda path: hb.load_chains(path.parent),
}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All files that have a version, in one folder."""
    import tomli_w

    from hydrabeam_mpi.cli import main

    folder = tmp_path_factory.mktemp("formats")
    (folder / "job.toml").write_text(tomli_w.dumps(JOB))
    assert main(["simulate", str(folder / "job.toml"), "-o", str(folder / "mock")]) == 0
    data = {"files": ["mock/data.uvh5"]}
    (folder / "job.toml").write_text(tomli_w.dumps({**JOB, "data": data, "loop": {"effects": ["antenna_gains"]}}))
    assert main(["loop", str(folder / "job.toml"), "-o", str(folder / "result")]) == 0
    (folder / "mock" / "truth.h5").rename(folder / "result" / "truth.h5")
    sampled = ["sample", str(folder / "job.toml"), "-o", str(folder / "chains"), "--chains", "1", "--draws", "2"]
    assert main(sampled) == 0
    (folder / "result" / "chains.json").symlink_to(folder / "chains" / "chains.json")
    return folder / "result"


def holds_numbers(item: h5py.Group | h5py.Dataset) -> bool:
    return isinstance(item, h5py.Dataset) and item.dtype.kind in "iufc"


def data_sets(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    with h5py.File(path) as file:
        found: list[tuple[str, dict[str, Any]]] = []
        file.visititems(lambda name, item: found.append((name, dict(item.attrs))) if holds_numbers(item) else None)
    yield from found


@pytest.mark.parametrize("name", ["posterior.h5", "truth.h5"])
def test_data_sets_tell_their_units_and_names(written: Path, name: str) -> None:
    told = dict(data_sets(written / name))
    assert len(told) > 6
    assert [name for name, attrs in told.items() if not (attrs.get("units") and attrs.get("long_name"))] == []


def test_draws_of_chains_tell_theirs(written: Path) -> None:
    (segment,) = (written.parent / "chains" / "chain-0").glob("*.h5")
    told = {name: attrs for name, attrs in data_sets(segment) if name.startswith("draws/")}
    assert told
    assert [name for name, attrs in told.items() if not {"units", "long_name"} <= attrs.keys()] == []


def test_what_the_loop_writes_is_as_the_schema_says(written: Path) -> None:
    schema = json.loads((files("hydrabeam_mpi.tables") / "loop.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    record = hb.load_loop(written / "loop.json")
    assert record["rounds"]
    jsonschema.validate(record, schema, cls=jsonschema.Draft202012Validator)
    with pytest.raises(jsonschema.ValidationError, match="another"):
        jsonschema.validate({**record, "another": 1}, schema)


@pytest.mark.parametrize("name", LOADERS)
def test_readers_take_their_own_and_refuse_later_ones(written: Path, name: str, tmp_path: Path) -> None:
    LOADERS[name](written / name)
    later = tmp_path / name
    set_format(written / name, later, 2)
    with pytest.raises(hb.InputError, match="is of format 2") as told:
        LOADERS[name](later)
    assert told.value.file == str(later)


@pytest.mark.parametrize("name", ["posterior.h5", "truth.h5", "loop.json"])
def test_files_of_before_there_were_versions_are_read(written: Path, name: str, tmp_path: Path) -> None:
    set_format(written / name, tmp_path / name, None)
    LOADERS[name](tmp_path / name)


@pytest.mark.parametrize("damage", ["one", 0, -3, 1.5, True])
def test_a_version_that_is_none_is_refused(written: Path, damage: Any, tmp_path: Path) -> None:
    set_format(written / "loop.json", tmp_path / "loop.json", damage)
    with pytest.raises(hb.InputError, match="format"):
        hb.load_loop(tmp_path / "loop.json")


def set_format(path: Path, target: Path, version: Any) -> None:
    """Copy a file, with another version or none."""
    target.write_bytes(path.read_bytes())
    if path.suffix == ".json":
        table = json.loads(path.read_text())
        table.pop("format")
        target.write_text(json.dumps(table if version is None else {**table, "format": version}))
        return
    with h5py.File(target, "r+") as file:
        del file.attrs["format"]
        if version is not None:
            file.attrs["format"] = version
