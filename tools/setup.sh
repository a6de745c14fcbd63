# shellcheck shell=bash
# Sourced by tools/demo and tools/test, which run in the repository root under `set -euo pipefail`:
#   set_up run     makes a virtual environment with the program and an MPI, and puts it first on PATH
#   set_up test    adds what the tests need
# Environment: HYDRABEAM_VENV (where; .venv), PYTHON (made with which interpreter),
# HYDRABEAM_MPI=wheel (leave the machine's own MPI alone and use MPICH from the package index).

fail() {
    [[ -z ${beat:-} ]] || kill "$beat"
    echo "${0##*/}: $*" >&2
    exit 1
}

# Run a command, and say every half minute what is waited for: installing and compiling take minutes.
step() {
    local what=$1 beat status=0
    shift
    echo "$what"
    # Ctrl-C does not reach what runs beside this shell, so that it looks whether this shell is there.
    while sleep 30 &>/dev/null && kill -0 $$ 2>/dev/null; do echo "  still $what ($SECONDS s)"; done &
    beat=$!
    "$@" || status=$?
    kill "$beat" 2>/dev/null || true
    wait "$beat" 2>/dev/null || true
    return "$status"
}

# macOS has bash 3.2, Perl and shasum, but nothing of GNU's coreutils.
if ! command -v timeout >/dev/null; then
    timeout() {
        while [[ $1 == --* ]]; do shift; done
        perl -e 'alarm shift; exec @ARGV or exit 127' "$@"
    }
fi

absolute() {
    realpath -m "$1" 2>/dev/null && return
    case $1 in
        /*) echo "$1" ;;
        *) echo "$PWD/$1" ;;
    esac
}

checksum() {
    sha256sum 2>/dev/null || shasum -a 256
}

is_recent_python() {
    "$1" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null
}

make_environment() {
    local python
    for python in ${PYTHON:+"$PYTHON"} python3.11 python3 python; do
        if is_recent_python "$python"; then
            step "making $venv with $(command -v "$python")" "$python" -m venv "$venv"
            return
        fi
    done
    fail "no Python 3.11 or later with its venv module on PATH; install one, or name it in PYTHON"
}

# PATH without virtual environments: an mpiexec or mpicc in one of those is not the machine's.
machine_path() {
    local entry path=
    local -a entries
    IFS=: read -r -a entries <<<"$PATH"
    for entry in "${entries[@]}"; do
        [[ $entry == "$venv/bin" || -e $entry/../pyvenv.cfg ]] || path+=${path:+:}$entry
    done
    echo "$path"
}

# Open MPI (4 and 5; others do not read these variables) must be told that a job may start as root, as in containers,
# and with more ranks than cores, as in the tests; and not to bind two ranks to one core each, where there are more.
permit_open_mpi() {
    if [[ $(id -u) == 0 ]]; then
        export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
    fi
    export OMPI_MCA_rmaps_base_oversubscribe=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
    export OMPI_MCA_hwloc_base_binding_policy=none PRTE_MCA_hwloc_default_binding_policy=none
}

# An mpicc alone is not enough: distributions ship it apart from mpi.h.
compiles_mpi() {
    local source=$'#include <mpi.h>\nint main(void) { return MPI_Init(0, 0); }'
    "$1" -x c -o "$venv/hydrabeam.probe" - <<<"$source" 2>/dev/null && rm "$venv/hydrabeam.probe"
}

# The machine's own MPI knows its network and its batch system, so it comes before the wheel.
choose_mpi() {
    local mpicc mpiexec
    mpi=wheel
    if [[ ${HYDRABEAM_MPI:-} != wheel ]] && mpiexec=$(command -v mpiexec); then
        if mpicc=$(command -v mpicc) && compiles_mpi "$mpicc"; then
            mpi=$mpicc
        else
            echo "no working mpicc beside $mpiexec: using MPICH from the package index instead"
        fi
    fi
}

install_mpi() {
    if [[ -f $venv/hydrabeam.mpi && $(<"$venv/hydrabeam.mpi") != "$mpi" ]]; then
        "${pip[@]}" uninstall --quiet --yes mpi4py mpich
    fi
    echo "$mpi" >"$venv/hydrabeam.mpi"
    if [[ $mpi == wheel ]]; then
        step "installing mpi4py and MPICH" "${pip[@]}" install "${pinned[@]}" mpi4py mpich
    else
        # Not from pip's cache, where an mpi4py built for another MPI may lie.
        MPICC=$mpi step "building mpi4py with $mpi" "${pip[@]}" install "${pinned[@]}" --no-cache-dir --no-binary mpi4py mpi4py ||
            fail "mpi4py cannot be built with $mpi; HYDRABEAM_MPI=wheel uses MPICH from the package index"
    fi
}

check_mpi() {
    local said mpiexec remedy
    mpiexec=$(command -v mpiexec)
    remedy="remove $venv and put the mpiexec and mpicc to be used first on PATH, or set HYDRABEAM_MPI=wheel"
    said=$(timeout --foreground 120 mpiexec -n 2 python -c '
import sys
from mpi4py.MPI import COMM_WORLD as world
if world.rank == 0:
    sys.stdout.write(f"world of {world.size}\n")' </dev/null 2>&1) || {
        echo "$said" >&2
        fail "$mpiexec -n 2 cannot start mpi4py (its words are above); $remedy"
    }
    case $said in
        *"world of 2"*) ;;
        *"world of 1"*) fail "$mpiexec -n 2 starts 2 worlds of 1 rank: it is not of the MPI of mpi4py; $remedy" ;;
        *) fail "$mpiexec -n 2 starts no world of 2 ranks but says: ${said//$'\n'/ }; $remedy" ;;
    esac
}

set_up() {
    local venv mpi key target
    venv=$(absolute "${HYDRABEAM_VENV:-.venv}")
    [[ -e $venv ]] || make_environment
    is_recent_python "$venv/bin/python" ||
        fail "$venv is no environment of Python 3.11 or later; remove it, or name another place in HYDRABEAM_VENV"

    PATH=$(machine_path)
    choose_mpi
    export PATH=$venv/bin:$PATH VIRTUAL_ENV=$venv
    permit_open_mpi

    key="$mpi $(cat requirements.lock pyproject.toml tools/setup.sh | checksum)"
    if [[ -f $venv/hydrabeam.$1 && $(<"$venv/hydrabeam.$1") == "$key" ]]; then
        return
    fi
    rm -f "$venv"/hydrabeam.{run,test}
    echo "installing into $venv (MPI: $mpi)"
    local -a pip=(python -m pip --disable-pip-version-check)
    local -a pinned=(--quiet --constraint requirements.lock)
    install_mpi
    # Editable: the checkout is what runs and what is tested, with no second copy to fall behind it.
    target=".[all]"
    [[ $1 == run ]] || target=".[$1]"
    step "installing hydrabeam_mpi and what it needs" "${pip[@]}" install "${pinned[@]}" --editable "$target"
    step "starting 2 ranks with $(command -v mpiexec)" check_mpi
    [[ $1 == run ]] || echo "$key" >"$venv/hydrabeam.run"
    echo "$key" >"$venv/hydrabeam.$1"
}
