"""Infer the primary beam of an interferometer from its visibilities, distributed over MPI."""

from importlib.metadata import PackageNotFoundError, version

from astropy.utils import iers

# Compute nodes have no network: a missing IERS table must not stall a run, and the packaged one is good to
# well below an arcsecond. Dates past its end are extrapolated.
iers.conf.auto_download = False
iers.conf.iers_degraded_accuracy = "warn"

try:
    __version__ = version("hydrabeam_mpi")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"
