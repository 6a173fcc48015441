#!/usr/bin/env bash
# A run on a cluster with PBS, which goes on by itself when the wall limit stops it:
#     qsub -v CASE=cases/all_protrude.toml cluster/pbs.sh
#     qsub -v CASE=cases/all_protrude.toml -J 1-8 cluster/pbs.sh          # one run for each seed from 1 to 8
#     qsub -v CASE=cases/all_protrude.toml,OPTIONS="--set particles.per_cell=20000" cluster/pbs.sh
# Add what your cluster asks for: project, queue.
#PBS -N cellmig
#PBS -l select=1:ncpus=8:mpiprocs=8
#PBS -l walltime=04:00:00
#PBS -r y
#PBS -j oe
set -uo pipefail
wall="3.9 h"  # a little less than walltime: PBS kills without notice

# Modules that your cluster needs, then the program: of a checkout, or in a container.
cd "${PBS_O_WORKDIR:-.}" || exit 3
cellmig=("${CELLMIG:-.venv/bin/cellmig}")
export OPENBLAS_NUM_THREADS=1  # the ranks are the threads

[[ ${CASE-} ]] || { echo "which case?  qsub -v CASE=cases/all_protrude.toml $0" >&2; exit 2; }
read -ra options <<<"${OPTIONS-}"
if [[ ${PBS_ARRAY_INDEX-} ]]; then
    name=$(basename "$CASE" .toml)
    options+=(--set "seed=$PBS_ARRAY_INDEX" --out "output/$name-seed$PBS_ARRAY_INDEX")
fi

mpiexec "${cellmig[@]}" run "$CASE" "${options[@]}" --resume auto --wall-time "$wall"
code=$?
# Not done yet: the same once more.  A task of an array comes back as a job of its own.
if [[ $code -eq 75 ]]; then
    qsub -v "CASE=$CASE,OPTIONS=${OPTIONS-}${PBS_ARRAY_INDEX:+ ${options[*]: -4}}" cluster/pbs.sh
fi
exit "$code"
