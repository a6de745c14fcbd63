"""``python -m hydrabeam_mpi``."""

import sys

from hydrabeam_mpi.cli import main

sys.exit(main())
