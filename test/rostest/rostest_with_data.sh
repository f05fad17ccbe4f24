#!/usr/bin/env bash
# Runs a rostest on the recorded data, or reports it as skipped (77) without them: PYTHON TEST_FILE RESULTS_DIR
set -euo pipefail
if [ ! -d "${SEMANTIC_TOPO_LOOP_DATA:-}/tum/fr2_desk" ]; then
  echo "SKIPPED: no tum/fr2_desk in SEMANTIC_TOPO_LOOP_DATA='${SEMANTIC_TOPO_LOOP_DATA:-}'"
  name=$(basename "$2" .test)
  mkdir -p "$3"
  printf '<testsuite name="%s" tests="1" skipped="1"><testcase name="%s"><skipped/></testcase></testsuite>\n' \
    "$name" "$name" > "$3/rostest_$name.xml"
  exit 77
fi
exec "$1" "$(command -v rostest)" --results-base-dir "$3" --results-filename "rostest_$(basename "$2" .test).xml" "$2"
