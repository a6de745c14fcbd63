"""``python -m hydrabeam_mpi``, and the program ``hydrabeam``."""

import os
import sys

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.launchers import task_of


def main() -> int:
    """Run the program; where there is no MPI for it, say so in one line.

    Returns
    -------
    int
        Exit status; see `hydrabeam_mpi.cli.main`.
    """
    try:
        from hydrabeam_mpi.cli import main as run
    except InputError as error:
        task = task_of(os.environ)
        if task is None or task.is_first:
            print(f"hydrabeam: error: {error}", file=sys.stderr)
        return 2
    return run()


if __name__ == "__main__":
    sys.exit(main())
