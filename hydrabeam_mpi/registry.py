"""Classes by the names that jobs give them, imported when they are first asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import TypeVar

Kind = TypeVar("Kind")


class Registry(Mapping[str, type[Kind]]):
    """Classes by name.

    The mistakes of a job file are told from the names alone, a second before astropy and scipy are imported.

    Parameters
    ----------
    package : str
        Below which the modules are.
    *modules
        One for each class, which has its name: in "sky.missing_sources" is `MissingSources`, and that is its key here.
    ending : str
        What the names of the classes end with besides.
    """

    def __init__(self, package: str, *modules: str, ending: str = "") -> None:
        self._package, self._ending = package, ending
        self._modules = {module.rpartition(".")[2]: module for module in modules}

    def __getitem__(self, kind: str) -> type[Kind]:
        module = import_module(f"{self._package}.{self._modules[kind]}")
        of_kind: type[Kind] = getattr(module, kind.title().replace("_", "") + self._ending)
        return of_kind

    def __contains__(self, kind: object) -> bool:
        return kind in self._modules  # without importing it

    def __iter__(self) -> Iterator[str]:
        return iter(self._modules)

    def __len__(self) -> int:
        return len(self._modules)
