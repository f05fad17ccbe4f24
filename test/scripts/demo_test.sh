#!/usr/bin/env bash
# scripts/demo: evaluates the run that it made, wherever its data and results are; on stand-ins for what it starts.
# usage: demo_test.sh SCRIPTS
set -euo pipefail
work=$(realpath "$(mktemp -d)")
trap 'rm -rf "$work"' EXIT
cd "$work"
cp "$1/demo" .
cat > common.sh <<'STAND_INS'
set -euo pipefail
build_dir=build
say() { :; }
install_dependencies() { :; }
build() { :; }
roslaunch() { # the last word on each argument counts
  local argument data output
  for argument in "$@"; do
    case $argument in data:=*) data=${argument#*:=} ;; output:=*) output=${argument#*:=} ;; esac
  done
  mkdir -p "$output"
  touch "$output/summary.json"
  echo "$data|$output" > launched
}
rosrun() { printf '%s\n' "${@:4}" >> evaluated; }
STAND_INS

expect() { # DATA RESULTS arguments...
  rm -rf launched evaluated
  ROS_HOME="$work/ros" ./demo "${@:3}" > log 2>&1 || { cat log >&2; exit 1; }
  [ "$(cat launched)" = "$1|$2" ] || { echo "failed: ran $(cat launched), not $1|$2" >&2; exit 1; }
  for file in "$2/trajectory.txt" "$2/trajectory_live.txt" "$2" "$1/groundtruth.txt" "$1/reference_objects.csv"; do
    grep -qxF "$file" evaluated || { echo "failed: evaluated, not $file:" >&2; cat evaluated >&2; exit 1; }
  done
  [ -f "$2/evaluation.txt" ]
}
usual=$work/ros/semantic_topo_loop/demo
expect "$usual" "$usual/results" images:=false
expect "$work/my data" "$work/my data/results" "data:=$work/my data"
expect "$usual" "$work/mine" output:=mine
expect "$work/here" "$work/there" data:=here output:=there
