#!/usr/bin/env bash
# Runs one amulett command on all nodes of a Slurm job, through a Ray cluster that lives as long as the job:
#
#   sbatch --nodes=4 --cpus-per-task=32 configs/slurm/amulett.sh tune-law gains --control all --out runs/gains
#
# amulett-gym with the extra `ray` has to be installed alike on all nodes; activate its environment before sbatch, which
# passes it on. A job that ends early is submitted again with the same command, and continues.
#SBATCH --job-name=amulett
#SBATCH --ntasks-per-node=1
#SBATCH --time=12:00:00
set -euo pipefail
if [ $# -eq 0 ]; then
    echo "usage: sbatch amulett.sh COMMAND [OPTIONS], for example tune-law gains --control all --out runs/gains" >&2
    exit 2
fi
port="${AMULETT_RAY_PORT:-6379}"
cores="${SLURM_CPUS_PER_TASK:-1}"
export RAY_USAGE_STATS_ENABLED=0
# Only who has the token in the home folder, which all nodes share, can use the cluster.
export RAY_AUTH_MODE=token
ray get-auth-token --generate >/dev/null

head="$(scontrol show hostnames "$SLURM_JOB_NODELIST" | head -n 1)"
address="$(srun --nodes=1 --ntasks=1 --nodelist="$head" hostname -I | awk '{print $1}'):$port"

# --block keeps a node in the foreground of its step, so that the end of the job ends it.
srun --nodes=1 --ntasks=1 --nodelist="$head" --overlap \
    ray start --head --node-ip-address="${address%:*}" --port="$port" --num-cpus="$cores" --block &
first=$!
until ray status --address="$address" >/dev/null 2>&1; do
    kill -0 "$first" 2>/dev/null || { echo "Ray did not start on $head" >&2; exit 1; }
    sleep 2
done
if [ "$SLURM_JOB_NUM_NODES" -gt 1 ]; then
    others=$((SLURM_JOB_NUM_NODES - 1))
    srun --nodes="$others" --ntasks="$others" --exclude="$head" --overlap \
        ray start --address="$address" --num-cpus="$cores" --block &
fi

# The batch script itself runs on the first node.
amulett "$@" --ray "$address"
