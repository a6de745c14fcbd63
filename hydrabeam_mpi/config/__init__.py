"""The job file: what it may say, and what is wrong with it where something is."""

from hydrabeam_mpi.config.job import Job, load_job, named_files
from hydrabeam_mpi.config.sections import Perturbation, Section, Simulate

__all__ = ["Job", "Perturbation", "Section", "Simulate", "load_job", "named_files"]
