#!/usr/bin/env bash
# scripts/figures: each line of docs/figures.json stands once in its document, and each number of the documents is measured
# or has a reason why not; and on a package of a few lines, with a program that writes what it is told, what differs is
# said, mended by --write, and counted.
# usage: figures_test.sh SCRIPTS
set -euo pipefail
scripts=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 "$scripts/tables/figures.py" --list > "$work/log" 2>&1 || {
  cat "$work/log" >&2
  echo "failed: docs/figures.json is stale, or numbers have neither a measurement nor a reason there" >&2
  exit 1
}

fail() {
  echo "failed: $*" >&2
  cat "$work/log" >&2
  exit 1
}

mkdir -p "$work/package/scripts" "$work/package/docs" "$work/programs"
cd "$work/package"
cp -r "$scripts/figures" "$scripts/tables" scripts/
touch package.xml
echo 'Nothing measured in Debian 12.' > README.md
cat > docs/benchmarks.md <<'DOCUMENT'
| ATE | 0.0123 m, 7 of 9 |

| house | joined | kept |
| --- | --- | --- |
| house 1 | 3 / 4 | 2 |
| house 2 | 5 / 6 | 8 |

It took 0.0123.

## Time

9.0 s, then 4.0 s

## Once

5.0 s
DOCUMENT
cat > "$work/programs/evaluate" <<'PROGRAM'
#!/usr/bin/env bash
[ -d "$1" ] || { echo "no folder '$1'" >&2; exit 1; }
echo '{"rmse": 0.01234, "right": 7}' > "$1/run.json"
echo '{"benchmarks": [{"name": "core/20", "cpu_time": 6100.0}]}' > "$1/core.json"
printf '%s\n' 'took 6.1 s' '**Houses**' '' '| house | joined | kept |' '| --- | --- | --- |' '| 1 | 3 / 4 | 2 |' '| 2 | 5 / 6 | 8 |'
PROGRAM
chmod +x "$work/programs/evaluate"
cat > docs/figures.json <<'JSON'
{"measurements": {"run": {"seconds": 1, "commands": ["evaluate $OUT"], "each": {"HOUSE": ["1", "2"]},
   "lines": {"docs/benchmarks.md": ["| ATE | {run.rmse:.4f} m, {run.right} of 9 |",
     "It took {run.rmse:.4f}.", "| house $HOUSE | {row('Houses', '$HOUSE', 'joined', 'kept')} |"]},
   "times": {"docs/benchmarks.md": ["{said('took ([0-9.]+) s'):.1f} s, then {core('core/20').cpu_time / 1000:.1f} s"]}},
  "long": {"seconds": 100, "commands": ["evaluate nowhere"], "lines": {}}},
 "not_measured": {"measured once": ["5\\.0 s"], "versions": ["Debian \\d+"]}}
JSON
figures() {
  scripts/figures "$work/programs" --output "$work/out" "$@" > "$work/log" 2>&1
}

figures --quick || fail "the documents' figures are today's"
grep -q '11 numbers measured, 0 differ' "$work/log" || fail "three numbers, six of houses and two times are measured"
grep -q '1 measured once' "$work/log" || fail "the reason of the number that is not measured"

sed -i -e 's/7 of 9/8 of 9/' -e 's|5 / 6|5 / 7|' -e 's/took 0.0123/took 0.0124/' docs/benchmarks.md
if figures --quick; then fail "three figures differ"; fi
grep -q '11 numbers measured, 3 differ' "$work/log" || fail "they are counted"
grep -q '8 is 7' "$work/log" || fail "it says which"
grep -q '5 / 7 | 8 is 5 / 6 | 8' "$work/log" || fail "it says which of a row of cells"
if figures --quick --write; then fail "three figures differed"; fi
grep -q '0.0123 m, 7 of 9' docs/benchmarks.md || fail "--write puts today's figure in"
grep -q 'It took 0.0123.$' docs/benchmarks.md || fail "of a sentence it takes the whole figure"
grep -q '5.0 s' docs/benchmarks.md || fail "--write leaves what is not measured"
grep -q '9.0 s, then 4.0 s' docs/benchmarks.md || fail "times within a factor of two are the same"
figures --quick --keep || fail "after that none differs"

sed -i 's/9.0 s, then/13.0 s, then/' docs/benchmarks.md
if figures --quick --keep --write; then fail "a time beyond a factor of two"; fi
grep -q '11 numbers measured, 1 differ' "$work/log" || fail "the other one is the same"
grep -q '6.1 s, then 4.0 s' docs/benchmarks.md || fail "--write puts the one in that differs"

if figures --keep; then fail "nothing was measured of one"; fi
grep -q 'long: error: .*printed.txt: not measured yet' "$work/log" || fail "it says so"

if figures; then fail "a measurement fails"; fi
grep -q "long: error: .*no folder 'nowhere'" "$work/log" || fail "it says which and why"
grep -q '11 numbers measured, 0 differ; 1 measurements failed' "$work/log" || fail "the others are measured all the same"

figures --list || fail "every number is measured or has a reason"
echo 'About 40 of them.' >> README.md
if figures --list; then fail "a number without either"; fi
grep -q 'README.md:2: 40' "$work/log" || fail "it is listed"
sed -i 's/ATE/error/' docs/benchmarks.md
if figures --quick --keep; then fail "a line that is not in the document"; fi
grep -q 'has 0 times, not once: | ATE' "$work/log" || fail "the error names it"
