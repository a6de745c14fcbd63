"""Chains as ArviZ and xarray know them: with names for all axes, units and long names."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import arviz_base
import numpy as np
import xarray as xr

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.storage.variable import Variable

INFO_UNITS = {"seconds": "s", "time": "s", "heldout_rms": "Jy"}


def to_datatree(store: ChainStore, names: Iterable[str] | None = None) -> xr.DataTree:
    """Return chains as a DataTree with the groups ``posterior`` and ``sample_stats``.

    Chains are cut to a common length, as ArviZ compares them; those that are less than half as long as the longest are
    left out. Complex variables become two, ``NAME_real`` and ``NAME_imag``: netCDF and ArviZ know none.

    Parameters
    ----------
    store : ChainStore
    names : iterable of str, optional
        Which variables; all by default.

    Returns
    -------
    DataTree
        Dimensions (chain, draw) and those of the variables; the warm-up is left out. What the chains are of stands in
        the attributes, in JSON.

    Raises
    ------
    InputError
        If there is no such variable.
    """
    chains, draws = store.comparable()
    variables = [store.variable(name) for name in names] if names is not None else list(store.variables)
    values: dict[str, FloatArray] = {}
    dims: dict[str, list[str]] = {}
    labels: dict[str, dict[str, str]] = {}
    for variable in variables:
        drawn = [store.read(variable.name, chain, draws) for chain in chains]
        for name, array in _real_parts(variable, np.stack(drawn) if drawn else np.empty((0, 0, *variable.shape))):
            values[name], dims[name] = array, _dims(variable, variables)
            labels[name] = {"units": variable.unit, "long_name": variable.long_name, "block": variable.block}
    coords: dict[str, Any] = {"chain": list(chains), "draw": np.arange(draws.stop - draws.start)}
    for variable in variables:
        own = zip(_dims(variable, variables), variable.dims, variable.shape, strict=True)
        coords |= {name: list(variable.coords.get(dim, range(size))) for name, dim, size in own}
    stats = {
        name: np.stack([store.info(name, chain, draws) for chain in chains])
        for name in (store.info_names(chains[0]) if chains else ())
    }
    tree = arviz_base.from_dict({"posterior": values, "sample_stats": stats}, coords=coords, dims=dims)
    for name, about in labels.items():
        tree["posterior"][name].attrs.update(about)
    for name in stats:
        tree["sample_stats"][name].attrs["units"] = INFO_UNITS.get(name, "")
    tree.attrs.update(_attributes(store))
    return tree


def _real_parts(variable: Variable, values: Any) -> Iterator[tuple[str, FloatArray]]:
    if variable.dtype == "complex128":
        yield f"{variable.name}_real", values.real
        yield f"{variable.name}_imag", values.imag
    else:
        yield variable.name, values


def _dims(variable: Variable, others: Iterable[Variable]) -> list[str]:
    """Name the axes of a variable; with its own name before, where another has other labels along one of that name."""

    def axes(one: Variable) -> Mapping[str, tuple[int, list[Any]]]:
        return {dim: (size, list(one.coords.get(dim, ()))) for dim, size in zip(one.dims, one.shape, strict=True)}

    ours = axes(variable)
    taken = [axes(other) for other in others]
    return [
        dim if all(one.get(dim, at) == at for one in taken) else f"{variable.name}_{dim}" for dim, at in ours.items()
    ]


def _attributes(store: ChainStore) -> dict[str, Any]:
    return {
        "inference_library": "hydrabeam_mpi",
        "identity": json.dumps(store.identity),
        "about": json.dumps(store.about),
        "warm_up": store.warm_up,
    }
