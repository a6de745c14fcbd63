"""The job file: what it may say, and what is wrong with it where something is."""

from hydrabeam_mpi.config.base import Section
from hydrabeam_mpi.config.job import Job, load_job
from hydrabeam_mpi.config.named import named_files
from hydrabeam_mpi.config.sections import ANALYTIC_BEAMS, BUILT_IN_BEAMS, EMBEDDED_BEAM, SkyColumns
from hydrabeam_mpi.config.simulation import Perturbation, Simulate

__all__ = [
    "ANALYTIC_BEAMS",
    "BUILT_IN_BEAMS",
    "EMBEDDED_BEAM",
    "Job",
    "Perturbation",
    "Section",
    "Simulate",
    "SkyColumns",
    "load_job",
    "named_files",
]
