#!/usr/bin/env bash
# Measures strong and weak scaling on a cluster with Slurm, to be laid beside what `cellmig bench --scaling` predicts:
#     sbatch --nodes=16 --ntasks-per-node=64 cluster/scaling.sh            # up to 1024 ranks
# Each line of scaling-JOB.jsonl is one measurement (nanoseconds per particle and step, exchange, looks, lists, memory).
#SBATCH --job-name=cellmig-scaling
#SBATCH --nodes=2
#SBATCH --ntasks-per-node=64
#SBATCH --cpus-per-task=1
#SBATCH --exclusive
#SBATCH --time=02:00:00
#SBATCH --output=%x-%j.log
set -uo pipefail

# Modules that your cluster needs, then a Python that has cellmig.
python=("${PYTHON:-${SLURM_SUBMIT_DIR:-.}/.venv/bin/python}")
export OPENBLAS_NUM_THREADS=1  # the ranks are the threads
found=scaling-${SLURM_JOB_ID:-0}.jsonl
code=0

# measure RANKS CELLS: cells of 1,500 particles in a row.
measure() {
    srun --ntasks="$1" "${python[@]}" -m cellmig.bench.timing "{\"bodies\": $2, \"per_body\": 1500}" >>"$found" || code=$?
}

for ((ranks = 1; ranks <= ${SLURM_NTASKS:-1}; ranks *= 2)); do
    measure "$ranks" 670              # strong: a million particles
    measure "$ranks" $((67 * ranks))  # weak: a hundred thousand a rank
done
echo "$found"
exit "$code"
