"""What pyuvdata compiles at its first use, kept on disk."""

from __future__ import annotations

from contextlib import suppress


def keep_compiled() -> None:
    """Let numba keep what it compiles of pyuvdata's functions of baseline numbers.

    Whoever reads or writes visibilities needs them, and compiling them takes each process more than a second. They are
    kept beside pyuvdata or in the user's cache, by processor; where neither can be written to nothing changes.
    """
    try:
        from pyuvdata.utils import bls_numba
    except ImportError:  # other versions of pyuvdata have them elsewhere, and compiled
        return
    for one in vars(bls_numba).values():
        with suppress(AttributeError, RuntimeError):
            one.enable_caching()
