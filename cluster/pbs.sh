#!/usr/bin/env bash
# A run on a cluster with PBS, which goes on by itself when the wall limit stops it:
#     qsub -v CASE=cases/all_protrude.toml cluster/pbs.sh
#     qsub -v CASE=cases/all_protrude.toml -J 1-8 cluster/pbs.sh          # one run for each seed from 1 to 8
#     qsub -v CASE=cases/all_protrude.toml,OPTIONS="--until '40 us'" cluster/pbs.sh
# Add what your cluster asks for: project, queue.
#PBS -N cellmig
#PBS -l select=1:ncpus=8:mpiprocs=8
#PBS -l walltime=04:00:00
#PBS -r y
#PBS -j oe
set -uo pipefail
# PBS kills without notice: a run stops by itself a tenth of its time, but at most five minutes, before the limit.
limit=${PBS_WALLTIME:-$(qstat -f "${PBS_JOBID-}" 2>/dev/null |
    awk -F '[=: ]+' '/Resource_List.walltime/ { print $(NF - 2) * 3600 + $(NF - 1) * 60 + $NF }')}
limit=${limit:-14400}
wall="$((limit - (limit < 3000 ? limit / 10 : 300))) s"

# Modules that your cluster needs, then the program: of a checkout, or in a container.
cd "${PBS_O_WORKDIR:-.}" || exit 3
cellmig=("${CELLMIG:-.venv/bin/cellmig}")
export OPENBLAS_NUM_THREADS=1  # the ranks are the threads

[[ ${CASE-} ]] || { echo "which case?  qsub -v CASE=cases/all_protrude.toml $0" >&2; exit 2; }
mapfile -t options < <(xargs -r -n 1 printf '%s\n' <<<"${OPTIONS-}")  # words with spaces are in quotes
more=
if [[ ${PBS_ARRAY_INDEX-} ]]; then
    array=(--set "seed=$PBS_ARRAY_INDEX" --out "output/$(basename "$CASE" .toml)-seed$PBS_ARRAY_INDEX")
    options+=("${array[@]}")
    more=$(printf ' %q' "${array[@]}")
fi

mpiexec "${cellmig[@]}" run "$CASE" "${options[@]}" --resume auto --wall-time "$wall"
code=$?
# Not done yet: the same once more.  A task of an array comes back as a job of its own.
if [[ $code -eq 75 ]]; then
    qsub -v "CASE=$CASE,OPTIONS=${OPTIONS-}$more" cluster/pbs.sh
fi
exit "$code"
