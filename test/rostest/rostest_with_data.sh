#!/usr/bin/env bash
# Runs a rostest on the recorded data, or reports it as skipped (77) without them: PYTHON TEST_FILE
if [ ! -d "${SEMANTIC_TOPO_LOOP_DATA:-}/tum/fr2_desk" ]; then
  echo "SKIPPED: no tum/fr2_desk in SEMANTIC_TOPO_LOOP_DATA='${SEMANTIC_TOPO_LOOP_DATA:-}'"
  exit 77
fi
rostest=$(command -v rostest) || { echo "rostest is not in PATH"; exit 1; }
exec "$1" "$rostest" "$2"
