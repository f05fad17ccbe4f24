#!/usr/bin/env bash
# scripts/fetch_data against a benchmark of file:// addresses: layout, resumption, checksums, errors.
# usage: fetch_data_test.sh SCRIPT
set -euo pipefail
command -v curl > /dev/null || { echo "skipped: curl is missing"; exit 77; }
script=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

fail() {
  echo "failed: $*" >&2
  cat log >&2
  exit 1
}

name=rgbd_dataset_freiburg3_long_office_household
mkdir -p server/yolo_txts data/tum/fr3_office
head -c 100000 /dev/urandom > "server/$name.bag"
echo '# truth' > "server/$name-groundtruth.txt"
echo '41 1 2 3 4 0.9' > server/yolo_txts/1.000000.txt
tar -czf server/yolo_txts.tar.gz -C server yolo_txts
echo a model > server/yolox_nano.onnx
fetch() {
  "$script" fr3_office yolox_nano --into data --mirror "file://$work/server" > log 2>&1
}

# What an interrupted download has left is not fetched again: the other bytes are.
head -c 40000 "server/$name.bag" > data/tum/fr3_office/fr3_office.bag.part
fetch || fail "a whole sequence"
cmp "server/$name.bag" data/tum/fr3_office/fr3_office.bag || fail "the bag's bytes"
[ -f data/tum/fr3_office/groundtruth.txt ] && [ -f data/tum/fr3_office/detections_yolov3/1.000000.txt ] || fail "layout"
[ "$(cat data/models/yolox_nano.onnx)" = "a model" ] || fail "the detector"
[ "$(wc -l < data/checksums.sha256)" = 4 ] || fail "checksums recorded"

rm -r server
fetch || fail "everything is there: nothing is fetched"
echo changed >> data/tum/fr3_office/groundtruth.txt
if fetch; then fail "a changed file"; fi
grep -q 'not what was first downloaded' log || fail "the changed file is named"
rm data/tum/fr3_office/groundtruth.txt
if fetch; then fail "a server that is not there"; fi
grep -q 'cannot fetch' log || fail "the address is named"
if "$script" fr9_desk > log 2>&1; then fail "an unknown name"; fi
grep -q "unknown name 'fr9_desk'" log || fail "the unknown name is named"
echo ok
