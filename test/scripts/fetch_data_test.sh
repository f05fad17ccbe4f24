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

# Every name that it knows.
sequences="fr1_xyz=freiburg1_xyz fr1_desk=freiburg1_desk fr1_room=freiburg1_room fr2_desk=freiburg2_desk
  fr2_dishes=freiburg2_dishes fr3_office=freiburg3_long_office_household"
for sequence in $sequences; do
  echo "bag of ${sequence%=*}" > "server/rgbd_dataset_${sequence#*=}.bag"
  echo "truth of ${sequence%=*}" > "server/rgbd_dataset_${sequence#*=}-groundtruth.txt"
done
echo '[]' > server/detections_yolov5_tum_rgbd_fr2_desk.json
echo a larger model > server/yolox_s.onnx
"$script" all yolox_nano yolox_s --into every --mirror "file://$work/server" > log 2>&1 || fail "every name"
for sequence in $sequences; do
  folder=every/tum/${sequence%=*}
  [ "$(cat "$folder/${sequence%=*}.bag" "$folder/groundtruth.txt")" = "bag of ${sequence%=*}
truth of ${sequence%=*}" ] || fail "the files of ${sequence%=*}"
done
cmp server/yolox_s.onnx every/models/yolox_s.onnx || fail "the larger detector"
# Two files a sequence, boxes of two of them, two detectors; in the folders also the unpacked boxes and the checksums.
[ "$(wc -l < every/checksums.sha256)" = 16 ] && [ "$(find every -type f | wc -l)" = 18 ] || fail "no file more or less"
[ -f every/tum/fr2_desk/detections_yolov5.json ] && [ -d every/tum/fr3_office/detections_yolov3 ] || fail "their boxes"
[ "$(grep -c 'no public detections are known' log)" = 4 ] || fail "sequences without boxes are named"

# What comes anew is held against the checksum of what came first.
rm every/models/yolox_s.onnx
echo another model > server/yolox_s.onnx
if "$script" yolox_s --into every --mirror "file://$work/server" > log 2>&1; then fail "a wrong checksum"; fi
grep -q 'models/yolox_s.onnx is not what was first downloaded' log || fail "the file of the wrong checksum is named"

rm -r server
fetch || fail "everything is there: nothing is fetched"
echo changed >> data/tum/fr3_office/groundtruth.txt
if fetch; then fail "a changed file"; fi
grep -q 'not what was first downloaded' log || fail "the changed file is named"
rm data/tum/fr3_office/groundtruth.txt
if fetch; then fail "a server that is not there"; fi
grep -q 'cannot fetch' log || fail "the address is named"
if "$script" yolox_s fr9_desk --into none > log 2>&1; then fail "an unknown name"; fi
grep -q "unknown name 'fr9_desk'" log || fail "the unknown name is named"
[ ! -e none ] || fail "nothing is fetched beside an unknown name"
echo ok
