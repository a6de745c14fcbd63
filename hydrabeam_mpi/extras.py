"""Packages that only some work needs, and by which extra of the installation they come."""

from __future__ import annotations

from importlib.util import find_spec

from hydrabeam_mpi.errors import InputError

EXTRAS = {
    "chains": ("arviz_base", "arviz_stats", "xarray"),
    "nufft": ("finufft",),
    "plot": ("matplotlib", "PIL", "jinja2", "markupsafe"),
}
"""Modules by extra. Together they are a quarter of an installation (228 MB), and few jobs on a cluster need them."""


def check_extra(extra: str, field: str) -> None:
    """Make sure that an extra is installed.

    Parameters
    ----------
    extra : str
        One of `EXTRAS`.
    field : str
        What needs it.

    Raises
    ------
    InputError
        If one of its modules is missing.
    """
    for module in EXTRAS[extra]:
        if not _is_there(module):
            remedy = f"pip install 'hydrabeam_mpi[{extra}]'"
            raise InputError(f"needs {module}, which is not installed", field=field, remedy=remedy)


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False
