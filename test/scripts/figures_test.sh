#!/usr/bin/env bash
# scripts/figures: each line of docs/figures.json stands once in its document; and on a package of two lines, with a
# program that writes what it is told, what differs is said, mended by --write, and what is a time is not compared.
# usage: figures_test.sh SCRIPTS
set -euo pipefail
scripts=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 "$scripts/tables/figures.py" --list > "$work/log" || { echo "failed: docs/figures.json is stale" >&2; exit 1; }

fail() {
  echo "failed: $*" >&2
  cat "$work/log" >&2
  exit 1
}

mkdir -p "$work/package/scripts" "$work/package/docs" "$work/programs"
cd "$work/package"
cp -r "$scripts/figures" "$scripts/tables" scripts/
touch package.xml
echo 'Nothing measured in 2 lines.' > README.md
printf '%s\n' '| ATE | 0.0123 m, 7 of 9 |' '| time | 5.0 s |' > docs/benchmarks.md
cat > "$work/programs/evaluate" <<'PROGRAM'
#!/usr/bin/env bash
echo '{"rmse": 0.01234, "right": 7, "seconds": 6.1}' > "$1/run.json"
PROGRAM
chmod +x "$work/programs/evaluate"
cat > docs/figures.json <<'JSON'
{"run": {"seconds": 1, "commands": ["evaluate $OUT"], "lines": {"docs/benchmarks.md": [
  "| ATE | {run.rmse:.4f} m, {run.right} of 9 |", "| time | {~run.seconds:.1f} s |"]}}}
JSON
figures() {
  scripts/figures "$work/programs" --output "$work/out" "$@" > "$work/log" 2>&1
}

figures --quick || fail "the documents' figures are today's"
grep -q '0 of 3 figures differ' "$work/log" || fail "three figures are compared or shown"
grep -q '5.0 is 6.1' "$work/log" || fail "the time is shown"

sed -i 's/7 of 9/8 of 9/' docs/benchmarks.md
if figures; then fail "a figure differs"; fi
grep -q '8 is 7' "$work/log" || fail "it says which"
if figures --write; then fail "a figure differed"; fi
grep -q '0.0123 m, 7 of 9' docs/benchmarks.md || fail "--write puts today's figure in"
grep -q '5.0 s' docs/benchmarks.md || fail "--write leaves times"
figures --keep || fail "after that none differs"

figures --list || fail "numbers without a measurement"
grep -q 'README.md:1: 2' "$work/log" || fail "the number of README.md is listed"
sed -i 's/ATE/error/' docs/benchmarks.md
if figures --keep; then fail "a line that is not in the document"; fi
grep -q 'has 0 times, not once: | ATE' "$work/log" || fail "the error names it"
