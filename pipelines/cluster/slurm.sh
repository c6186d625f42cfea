#!/bin/sh
# Computes a campaign with Slurm: plans here, a task of an array a shard, and a job that gathers when all of them have ended.
#
#   pipelines/cluster/slurm.sh OUT SHARDS PIPELINE --campaign DIR [--set ...] -- [options of sbatch for a shard, such as --cpus-per-task=4 --time=02:00:00]
#
# To go on after a failure, or after `scancel`, give the same command again: what is finished is not dealt out again.
set -eu

case "${1:-}" in
shard) # a task of the array: the line of its number
    key=$(sed -n "$((SLURM_ARRAY_TASK_ID + 1))p" "$3")
    exec periscope run-shard "$key" --out "$2" --threads "${SLURM_CPUS_PER_TASK:-1}" --progress none
    ;;
gather) # exit code 3: done, but some input was rejected
    periscope gather --out "$2" --threads "${SLURM_CPUS_PER_TASK:-1}" --progress none --wait || [ $? -eq 3 ]
    exit
    ;;
esac

[ $# -ge 4 ] || { sed -n '2,6s/^# \{0,1\}//p' "$0" >&2; exit 2; }
out=$1 shards=$2
shift 2
# Words before `--` are for `plan`, those after it for sbatch.
count=$# is_plan=1 plan=
while [ "$count" -gt 0 ]; do
    word=$1 count=$((count - 1))
    shift
    if [ "$word" = -- ]; then
        is_plan=
    elif [ -n "$is_plan" ]; then
        plan="$plan '$(printf %s "$word" | sed "s/'/'\\\\''/g")'"
    else
        set -- "$@" "$word"
    fi
done
mkdir -p "$out.shards"
eval "periscope plan $plan --out \"\$out\" --shards \"\$shards\" --format csv" > "$out.shards/plan.csv"
tail -n +2 "$out.shards/plan.csv" | cut -d, -f1 > "$out.shards/keys"
tasks=$(wc -l < "$out.shards/keys")
after=
if [ "$tasks" -gt 0 ]; then
    log="$out.shards/%a.log"
    array=$(sbatch --parsable --array="0-$((tasks - 1))" --requeue --output="$log" "$@" "$0" shard "$out" "$out.shards/keys")
    after="--dependency=afterok:${array%%;*}"
fi
# shellcheck disable=SC2086 # no dependency is no word
sbatch --parsable $after --output="$out.shards/gather.log" "$@" "$0" gather "$out"
