"""Functions that numba compiles, of this package and of pyuvdata, kept on disk."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from typing import Any


class Compiled:
    """A function of arrays and numbers that is compiled when it is first called.

    Neither numba nor its compiler is waited for by who does not call it. Sums may be taken in any order.

    Parameters
    ----------
    function : callable
    """

    def __init__(self, function: Callable[..., None]) -> None:
        self.function = function

    def __call__(self, *args: Any) -> None:
        """Call the compiled function."""
        self._machine_code(*args)

    @cached_property
    def _machine_code(self) -> Callable[..., None]:
        from numba import njit

        compiled = njit(self.function, error_model="numpy", fastmath={"contract", "reassoc"})
        _keep(compiled)
        return compiled


def keep_compiled() -> None:
    """Let numba keep what it compiles of pyuvdata's functions of baseline numbers.

    Whoever reads or writes visibilities needs them, and compiling them takes each process more than a second.
    """
    try:
        from pyuvdata.utils import bls_numba
    except ImportError:  # other versions of pyuvdata have them elsewhere, and compiled
        return
    for one in vars(bls_numba).values():
        _keep(one)


def _keep(compiled: Any) -> None:
    """Keep what is compiled on disk, by processor, beside its source or in the user's cache, where that is possible."""
    with suppress(AttributeError, RuntimeError):
        compiled.enable_caching()
