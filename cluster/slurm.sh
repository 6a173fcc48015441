#!/usr/bin/env bash
# A run on a cluster with Slurm, which goes on by itself when the wall limit stops it:
#     sbatch cluster/slurm.sh cases/all_protrude.toml --set particles.per_cell=20000
#     sbatch --array=1-8 cluster/slurm.sh cases/all_protrude.toml         # one run for each seed from 1 to 8
# `cellmig sweep … --slurm` writes arrays for any other values.  Add what your cluster asks for: account, partition.
#SBATCH --job-name=cellmig
#SBATCH --ntasks=8
#SBATCH --cpus-per-task=1
#SBATCH --time=04:00:00
#SBATCH --signal=USR1@60
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=%x-%j.log
set -uo pipefail

# Modules that your cluster needs, then the program: of a checkout, or in a container such as
#   cellmig=(apptainer exec "$HOME/cellmig.sif" cellmig)
cellmig=("${CELLMIG:-${SLURM_SUBMIT_DIR:-.}/.venv/bin/cellmig}")
export OPENBLAS_NUM_THREADS=1  # the ranks are the threads

if [[ ${SLURM_ARRAY_TASK_ID-} ]]; then
    name=$(basename "$1" .toml)
    set -- "$@" --set "seed=$SLURM_ARRAY_TASK_ID" --out "output/$name-seed$SLURM_ARRAY_TASK_ID"
fi
# A run stops with a checkpoint a tenth of its time, but at most five minutes, before the limit: by itself where Slurm
# tells the end, else by SIGUSR1 in the last minute.
left=$((${SLURM_JOB_END_TIME:-0} - $(date +%s)))
((left < 10)) || set -- "$@" --wall-time "$((left - (left < 3000 ? left / 10 : 300))) s"

srun "${cellmig[@]}" run "$@" --resume auto
code=$?
if [[ $code -eq 75 ]]; then
    job=$SLURM_JOB_ID
    [[ -z ${SLURM_ARRAY_TASK_ID-} ]] || job=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
    scontrol requeue "$job"
fi
exit "$code"
