"""Mutations of HDF5 files: fields removed, renamed, of another type or shape, and numbers that cannot be."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tests.faults.damage import Damage, Mutator, Rng, pick

# What a file need not have: the documentation says what is taken in its place.
OPTIONAL = re.compile(r"pol_convention|orientation|vis_units|uvw_array|history|extra_keywords|blts_are|feed_|mount")
NUMBERS = (np.nan, np.inf, -np.inf, 1e300, -1e300)
# A negative value of these means nothing; of nsamples it is a flag.
POSITIVE = re.compile(r"time|freq|width|integration|sigma|N[a-z]+s$|nside")

Change = Callable[[h5py.File, Rng], Damage]


def _hdf5(change: Change) -> Mutator:
    def mutate(path: Path, rng: Rng) -> Damage:
        with h5py.File(path, "r+") as file:
            return change(file, rng)

    return mutate


def datasets(file: h5py.File) -> list[str]:
    """Name all of them, in order."""
    names: list[str] = []
    file.visit(names.append)
    return sorted(name for name in names if isinstance(file[name], h5py.Dataset) and file[name].shape is not None)


def numeric(file: h5py.File, kinds: str = "fciub") -> list[str]:
    """Name the datasets of numbers; compound types of two floats are complex numbers."""
    return [name for name in datasets(file) if file[name].dtype.kind in kinds and file[name].size]


def put(file: h5py.File, name: str, values: Any) -> None:
    """Replace a dataset by another of any type and shape."""
    attributes = dict(file[name].attrs)
    del file[name]
    file[name] = values
    file[name].attrs.update(attributes)


def delete(file: h5py.File, rng: Rng) -> Damage:
    name = pick(rng, datasets(file))
    del file[name]
    return Damage(f"{name} deleted", illegal=not OPTIONAL.search(name))


def delete_group_or_attribute(file: h5py.File, rng: Rng) -> Damage:
    holders: list[str] = ["/"]
    file.visit(holders.append)
    attributes = [(name, key) for name in sorted(holders) for key in sorted(file[name].attrs)]
    groups = [name for name in sorted(holders) if name != "/" and isinstance(file[name], h5py.Group)]
    if attributes and (not groups or rng.random() < 0.7):
        name, key = pick(rng, attributes)
        if rng.random() < 0.5:
            del file[name].attrs[key]
            return Damage(f"attribute {key} of {name} deleted")
        file[name].attrs[key] = pick(rng, ["x", -1, float("nan"), "{}", "[1, 2]", '{"a": {"b": [[[]]]}}', b"\xff\xfe"])
        return Damage(f"attribute {key} of {name} replaced")
    if not groups:
        return delete(file, rng)
    name = pick(rng, groups)
    del file[name]
    return Damage(f"group {name} deleted", illegal=not OPTIONAL.search(name))


def rename(file: h5py.File, rng: Rng) -> Damage:
    name = pick(rng, datasets(file))
    file.move(name, name + "_")
    return Damage(f"{name} renamed", illegal=not OPTIONAL.search(name))


def retype(file: h5py.File, rng: Rng) -> Damage:
    name = pick(rng, datasets(file))
    values = file[name][()]
    kind = pick(rng, ["text", "complex", "float", "int", "group", "bytes"])
    if kind == "group":
        del file[name]
        file.create_group(name)
    elif kind == "text":
        put(file, name, np.full(np.shape(values), "text", dtype=h5py.string_dtype()))
    elif kind == "bytes":
        put(file, name, np.void(b"\xff\x00bytes"))
    elif np.asarray(values).dtype.kind not in "fciub":
        put(file, name, np.zeros(np.shape(values)))
    elif kind == "complex":
        put(file, name, np.asarray(values) + 1j)
    else:
        put(file, name, np.real(values).astype(kind))
    return Damage(f"{name} made {kind}", illegal=kind in ("text", "group", "bytes") and not OPTIONAL.search(name))


def reshape(file: h5py.File, rng: Rng) -> Damage:
    name = pick(rng, datasets(file))
    values = np.asarray(file[name][()])
    way = pick(rng, ["shorter", "longer", "flat", "turned", "deeper", "empty", "scalar"])
    axis = int(rng.integers(max(values.ndim, 1)))
    if way == "shorter" and values.ndim:
        values = np.delete(values, -1, axis) if values.shape[axis] else values
    elif way == "longer" and values.ndim:
        values = np.concatenate([values, np.take(values, [0], axis)], axis) if values.shape[axis] else values
    elif way == "turned" and values.ndim > 1:
        values = values.T
    elif way == "deeper":
        values = values[np.newaxis]
    elif way == "empty":
        values = values.reshape(-1)[:0]
    elif way == "scalar" and values.size:
        values = values.reshape(-1)[0]
    else:
        values = values.reshape(-1)
    put(file, name, values)
    return Damage(f"{name} {way} along {axis}", illegal=way in ("shorter", "longer") and not OPTIONAL.search(name))


def strange_number(file: h5py.File, rng: Rng) -> Damage:
    """One value, or all of them, that is not a number or beyond any."""
    names = numeric(file, "fc")
    name, number, everywhere = pick(rng, names), pick(rng, NUMBERS), rng.random() < 0.3
    values = np.asarray(file[name][()])
    place = tuple(int(rng.integers(n)) for n in values.shape)
    with np.errstate(over="ignore"):
        values[... if everywhere else place] = number
    file[name][...] = values
    where = "" if everywhere else list(place)
    return Damage(f"{name}{where} = {number}", illegal=not OPTIONAL.search(name))


def strange_integer(file: h5py.File, rng: Rng) -> Damage:
    names = numeric(file, "iu")
    if not names:
        return strange_number(file, rng)
    name, number = pick(rng, names), pick(rng, [-1, 0, 99, 2**31 - 1, -(2**31)])
    values = np.asarray(file[name][()])
    place = tuple(int(rng.integers(n)) for n in values.shape)
    values[place] = np.array(number).astype(values.dtype)
    file[name][...] = values
    return Damage(f"{name}{list(place)} = {number}")


def negate(file: h5py.File, rng: Rng) -> Damage:
    name = pick(rng, numeric(file, "fc"))
    file[name][...] = -file[name][()]
    return Damage(f"{name} negated", illegal=bool(POSITIVE.search(name)))


def shift_times(file: h5py.File, rng: Rng) -> Damage:
    names = [name for name in numeric(file, "f") if "time_array" in name and "integration" not in name]
    if not names:
        return strange_number(file, rng)
    days = pick(rng, [-2400000.5, 1e5, -1e5, -2459866.0])
    file[names[0]][...] = file[names[0]][()] + days
    return Damage(f"{names[0]} shifted by {days} d", illegal=True)


def all_alike(file: h5py.File, rng: Rng) -> Damage:
    """Every value of a field is the first one, as of two channels at one frequency."""
    name = pick(rng, numeric(file))
    values = np.asarray(file[name][()])
    values[...] = values.reshape(-1)[0]
    file[name][...] = values
    return Damage(f"{name} all alike", illegal=name.endswith(("freq_array", "freqs")))


def asymmetric(file: h5py.File, rng: Rng) -> Damage:
    """Spoil a covariance."""
    names = [name for name in numeric(file, "fc") if "covariance" in name]
    if not names:
        return strange_number(file, rng)
    values = np.asarray(file[names[0]][()])
    if rng.random() < 0.5:
        values[0, 1] += values[0, 0]
        what = "asymmetric"
    else:
        values = values - 2 * np.trace(values).real / len(values) * np.eye(len(values))
        what = "indefinite"
    file[names[0]][...] = values
    return Damage(f"{names[0]} {what}", illegal=True)


HDF5: tuple[Mutator, ...] = tuple(
    map(
        _hdf5,
        (
            delete, delete_group_or_attribute, rename, retype, retype, reshape, reshape, strange_number, strange_number,
            strange_number, strange_integer, negate, shift_times, all_alike, asymmetric,
        ),
    )
)  # fmt: skip
