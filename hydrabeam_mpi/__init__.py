"""Infer the primary beam of an interferometer from its visibilities, distributed over MPI.

    import hydrabeam_mpi as hb

    result = hb.infer(hb.Setup(uvd, beam=uvbeam, sky=skymodel))

What is public stands in ``__all__``, and is imported when it is first asked for: importing this package starts no MPI
and waits for no astronomy packages.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hydrabeam_mpi.extras import check_extra
from hydrabeam_mpi.version import __version__

if TYPE_CHECKING:
    from hydrabeam_mpi.api.arguments import FourierBessel, Zernike
    from hydrabeam_mpi.api.beam import InferredBeam
    from hydrabeam_mpi.api.chains import Chains, load_chains
    from hydrabeam_mpi.api.corrected import Correction
    from hydrabeam_mpi.api.correction import correct
    from hydrabeam_mpi.api.inference import infer
    from hydrabeam_mpi.api.loading import load, load_loop, load_posterior
    from hydrabeam_mpi.api.loop import close_loop
    from hydrabeam_mpi.api.plan import Plan, plan
    from hydrabeam_mpi.api.prediction import Prediction, predict
    from hydrabeam_mpi.api.result import Found, Result
    from hydrabeam_mpi.api.results import Results
    from hydrabeam_mpi.api.sampling import sample
    from hydrabeam_mpi.api.setup import Setup
    from hydrabeam_mpi.api.simulation import Mock, simulate
    from hydrabeam_mpi.errors import InputError
    from hydrabeam_mpi.io.truth_file import Truth, load_truth

_HOMES = {
    "Chains": "api.chains",
    "Correction": "api.corrected",
    "FourierBessel": "api.arguments",
    "Found": "api.result",
    "InferredBeam": "api.beam",
    "InputError": "errors",
    "Mock": "api.simulation",
    "Plan": "api.plan",
    "Prediction": "api.prediction",
    "Result": "api.result",
    "Results": "api.results",
    "Setup": "api.setup",
    "Truth": "io.truth_file",
    "Zernike": "api.arguments",
    "close_loop": "api.loop",
    "correct": "api.correction",
    "infer": "api.inference",
    "load": "api.loading",
    "load_chains": "api.chains",
    "load_loop": "api.loading",
    "load_posterior": "api.loading",
    "load_truth": "io.truth_file",
    "plan": "api.plan",
    "predict": "api.prediction",
    "sample": "api.sampling",
    "simulate": "api.simulation",
}

_EXTRAS = {"sample": "chains"}  # what is needed besides; see `hydrabeam_mpi.extras`

__all__ = [
    "Chains",
    "Correction",
    "Found",
    "FourierBessel",
    "InferredBeam",
    "InputError",
    "Mock",
    "Plan",
    "Prediction",
    "Result",
    "Results",
    "Setup",
    "Truth",
    "Zernike",
    "__version__",
    "close_loop",
    "correct",
    "infer",
    "load",
    "load_chains",
    "load_loop",
    "load_posterior",
    "load_truth",
    "plan",
    "predict",
    "sample",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name in _EXTRAS:
        check_extra(_EXTRAS[name], name)
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
