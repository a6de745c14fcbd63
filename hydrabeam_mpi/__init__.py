"""Infer the primary beam of an interferometer from its visibilities, distributed over MPI."""

from importlib.metadata import PackageNotFoundError, version

from astropy.utils import iers

# Compute nodes have no network: a missing IERS table must not stall a run, and the packaged one is good to
# well below an arcsecond, however old: its predictions hold for the dates that they are of. What dates past its end
# cost, `hydrabeam_mpi.model.earth_orientation` tells.
iers.conf.auto_download = False
iers.conf.auto_max_age = None
iers.conf.iers_degraded_accuracy = "warn"

try:
    __version__ = version("hydrabeam_mpi")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"
