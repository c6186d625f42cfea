#!/usr/bin/env bash
# Runs one campaign on emulated CPUs of other kinds, and compares every table with that of this machine: docs/reliability.md, "Other kinds of CPU".
# usage: tests/other_cpus.sh PERISCOPE     on x86-64, with qemu-user (Debian: apt-get install qemu-user)
set -euo pipefail
periscope=$(realpath "${1:?usage: tests/other_cpus.sh PERISCOPE}")
here=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
"$periscope" simulate "$here/pipelines/scenes/around-the-corner.toml" --out campaign > /dev/null
run() {
    local out=$1
    shift
    "$@" "$periscope" run scene --campaign campaign --out "$out" --progress none > /dev/null
}
run here
for cpu in Nehalem SandyBridge Haswell Skylake-Client; do
    run "$cpu" qemu-x86_64 -cpu "$cpu" 2> /dev/null
    echo "== $cpu"
    "$periscope" diff here "$cpu" --all || true
done
