"""Measures again what the documents state and says which figures differ; ends with 0 if none does.

docs/figures.json lists, as "measurements", commands that write files into a folder of their own, and for each the lines
of documents with {expressions} in place of the figures. An expression is Python over what the commands wrote: NAME.json
and NAME/summary.json by their name (`after.ate_m.rmse`; Google Benchmark's by a benchmark's, `core("project").real_time`),
`spent_us("run", "loop")`, `peak_mb("run")` and `count("run/loops.csv", column="value")` of a run, and what they printed:
`said(regular expression)` is the first number in its group, `said(regular expression, 1)` the second, `cell(heading,
row..., column)` that of a Markdown table, `row(heading, first cell, first column, last column)` those between two columns.
`$NAME` in a line stands for each of the values that the measurement's "each" has for it. A line that does not stand in its
document once is an error. Those of "times", which hang on the machine, differ if they are more than a factor of 2 apart;
measurements that run "alone" run before the others. What is not measured has a reason there, with regular expressions; a
number without either is shown by --list, which then ends with 1."""

import argparse
import collections
import concurrent.futures
import glob
import json
import os
import re
import shlex
import shutil
import statistics
import subprocess
import sys
import time
from types import SimpleNamespace

from runs import Failure, package_folder, read_rows

PACKAGE = package_folder()
DOCUMENTS = ("README.md", "docs/benchmarks.md")
PLACE = re.compile(r"\{([^{}]+?)(?::([.,\d]*[a-z%]))?\}")
NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?")
CODE = re.compile(r"```.*?```|`[^`\n]*`|\]\([^)\n]*\)", re.DOTALL)
PRINTED = "printed.txt"  # of a measurement's folder: what its commands said
MEASURED, ROW = "measured", "in the names of rows that are measured"
QUICK_S = 60.0
TIMES_WITHIN = 2.0


class Template:
    """A line of a document with expressions in place of its figures, which are the same within a factor."""

    def __init__(self, document, text, within):
        self.document, self.text, self._within = document, text, within
        self.places = list(PLACE.finditer(text))
        pattern, end = "", 0
        for place in self.places:
            # A row of cells has strokes in it; any other figure has none.
            pattern += re.escape(text[end:place.start()]) + (r"(.+?)" if place.group(1).startswith("row(") else r"([^|\n]+?)")
            end = place.end()
        pattern += re.escape(text[end:])
        is_row = text.startswith("|") and text.endswith("|")
        self._pattern = re.compile(f"^{pattern}$" if is_row else pattern + r"(?!\d)", re.MULTILINE)

    def find(self, document_text):
        """@return the one place where it stands"""
        found = list(self._pattern.finditer(document_text))
        if len(found) != 1:
            raise Failure(f"{self.document} has {len(found)} times, not once: {self.text}")
        return found[0]

    def figures(self, values):
        """Text of each place."""
        for place in self.places:
            expression, layout = place.groups()
            try:
                value = eval(expression, {}, values)
            except Exception as error:  # whatever the commands wrote
                raise Failure(f"{expression} in '{self.text}': {error!r}")
            yield format(value, layout or "")

    def differing(self, stated, now):
        """How many numbers of one text differ from those of the other."""
        a, b = NUMBER.findall(stated), NUMBER.findall(now)
        differ = sum(not self._is_same(x, y) for x, y in zip(a, b)) + abs(len(a) - len(b))
        return differ or int(NUMBER.sub("", stated) != NUMBER.sub("", now))

    def _is_same(self, stated, now):
        smaller, larger = sorted(float(number.replace(",", "")) for number in (stated, now))
        return larger <= self._within * smaller


def templates_of(entry):
    """The lines of a measurement; each value of what stands in them as $NAME makes one of its own."""
    def expanded(text):
        for name, values in entry.get("each", {}).items():
            if "$" + name in text:
                return [line for value in values for line in expanded(text.replace("$" + name, value))]
        return [text]

    return [Template(document, line, within) for kind, within in (("lines", 1.0), ("times", TIMES_WITHIN))
            for document, lines in entry.get(kind, {}).items() for text in lines for line in expanded(text)]


def namespace(value):
    if isinstance(value, dict):
        return SimpleNamespace(**{key: namespace(other) for key, other in value.items()})
    return [namespace(other) for other in value] if isinstance(value, list) else value


def ratio(figures):
    """A ratio with its counts, as the documents have it."""
    return f"{figures.value:.3f} ({figures.right} / {figures.total})"


def spaced(text):
    """`0.999 (3702/3705)` with spaces about the stroke."""
    return text.replace("/", " / ")


def counts(text):
    """`3702 / 3705` of `0.999 (3702/3705)`."""
    return spaced(text[text.index("(") + 1:-1])


class Tables:
    """Cells of Markdown tables, by the text above a table, the first cells of a row and the name of a column."""

    def __init__(self, text):
        self._tables, above = [], ""
        for line in text.splitlines():
            if line.startswith("|"):
                cells = [cell.strip() for cell in line.strip("|").split("|")]
                if above is not None:
                    self._tables.append((above, cells, []))
                    above = None
                elif not set("".join(cells)) <= set("-"):
                    self._tables[-1][2].append(cells)
            elif line.strip():
                above = line

    def _find(self, heading, first_cells):
        """@return columns and cells of the first such row"""
        for above, columns, rows in self._tables:
            for cells in rows if heading in above else []:
                if cells[:len(first_cells)] == first_cells:
                    return columns, cells
        raise KeyError((heading, *first_cells))

    def cell(self, heading, *row_and_column):
        *row, column = row_and_column
        columns, cells = self._find(heading, row)
        return cells[columns.index(column)]

    def row(self, heading, first_cell, first, last):
        """Cells of the columns of these names and of those between."""
        columns, cells = self._find(heading, [first_cell])
        return " | ".join(cells[columns.index(first):columns.index(last) + 1])


class Runs:
    """What `offline` wrote, by the folder of a run."""

    def __init__(self, folder):
        self._folder = folder

    def spent_us(self, run, stage):
        """Of a stage at a frame: mean, median, 99th percentile and most."""
        values = sorted(float(row[stage + "_us"]) for row in read_rows(os.path.join(self._folder, run, "timing.csv")))
        return SimpleNamespace(mean=statistics.mean(values), median=statistics.median(values), most=values[-1],
                               p99=values[int(0.99 * (len(values) - 1))])

    def peak_mb(self, run):
        return max(float(row["peak_mb"]) for row in read_rows(os.path.join(self._folder, run, "memory.csv")))

    def count(self, path, **cells):
        """Rows of a file that have these cells."""
        return sum(all(row[name] == value for name, value in cells.items())
                   for row in read_rows(os.path.join(self._folder, path)))


def values_of(folder):
    """Names that the expressions of a measurement may use."""
    path = os.path.join(folder, PRINTED)
    if not os.path.exists(path):
        raise Failure(f"{path}: not measured yet")
    with open(path) as file:
        printed = file.read()
    tables, runs = Tables(printed), Runs(folder)
    values = {"ratio": ratio, "spaced": spaced, "counts": counts, "cell": tables.cell, "row": tables.row,
              "spent_us": runs.spent_us, "peak_mb": runs.peak_mb, "count": runs.count,
              "said": lambda expression, i=0: float(re.findall(expression, printed)[i].replace(",", ""))}
    for path in glob.glob(os.path.join(folder, "*.json")):
        with open(path) as file:
            written = namespace(json.load(file))
        if hasattr(written, "benchmarks"):
            written = {entry.name: entry for entry in written.benchmarks}.__getitem__
        values[os.path.basename(path)[:-5]] = written
    for path in glob.glob(os.path.join(folder, "*", "summary.json")):
        with open(path) as file:
            values[os.path.basename(os.path.dirname(path))] = namespace(json.load(file))
    return values


def measure(name, commands, arguments):
    """Runs the commands of a measurement. @return its folder, seconds"""
    folder = os.path.join(arguments.output, name)
    begin = time.monotonic()
    if arguments.keep:
        return folder, 0.0
    shutil.rmtree(folder, ignore_errors=True)  # what no command writes any more is no figure of today
    os.makedirs(folder)
    environment = dict(os.environ, SEMANTIC_TOPO_LOOP_DATA=arguments.data, ROS_PACKAGE_PATH=PACKAGE)
    with open(os.path.join(folder, PRINTED), "w") as printed:
        for command in commands:
            words = [word.replace("$DATA", arguments.data).replace("$OUT", folder).replace("$CONFIG", PACKAGE + "/config")
                     .replace("$PROGRAMS", arguments.programs) for word in shlex.split(command)]
            words[0] = os.path.join(PACKAGE if "/" in words[0] else arguments.programs, words[0])
            result = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True,
                                    env=environment)
            if result.returncode != 0:
                raise Failure(f"{shlex.join(words)}: {result.stderr.strip()[-2000:]}")
            printed.write(result.stdout)
    return folder, time.monotonic() - begin


def compare(template, values, text):
    """@return the document's text with today's figures, how many numbers these are, and how many of them differ"""
    found = template.find(text)
    changes, parts, end, total, differ = [], [], found.start(), 0, 0
    for i, now in enumerate(template.figures(values), 1):
        stated = found.group(i)
        total += len(NUMBER.findall(now))
        others = template.differing(stated, now)
        if others > 0:
            differ += others
            changes.append(f"{stated} is {now}")
        parts += [text[end:found.start(i)], now if others > 0 else stated]
        end = found.end(i)
    if changes:
        print(f"  {template.document}: differs: {', '.join(changes)}; in: {found.group(0)}")
    return text[:found.start()] + "".join(parts) + text[end:], total, differ


def reasons_of(document, text, templates, not_measured):
    """(number as a match, why it is not measured, or MEASURED, or "" if nobody knows); code is left out."""
    code = [match.span() for match in CODE.finditer(text)]
    spans = []  # (begin, end, reason); the first one counts
    lines = [t.find(text) for t in templates if t.document == document]
    spans += [(*found.span(i + 1), MEASURED) for found in lines for i in range(len(found.groups()))]
    spans += [(*found.span(), ROW) for found in lines]
    spans += [(*found.span(), reason) for reason, patterns in not_measured.items() for pattern in patterns
              for found in re.finditer(pattern, text)]
    for number in NUMBER.finditer(text):
        if not any(begin <= number.start() < end for begin, end in code):
            yield number, next((reason for begin, end, reason in spans if begin <= number.start() < end), "")


def count_reasons(texts, templates, not_measured):
    """Prints the numbers that nothing accounts for. @return how many numbers each reason has"""
    total = collections.Counter()
    for document, text in texts.items():
        unknown = {}
        for number, reason in reasons_of(document, text, templates, not_measured):
            total[reason] += 1
            if not reason:
                unknown.setdefault(text.count("\n", 0, number.start()) + 1, []).append(number.group())
        for line, found in unknown.items():
            print(f"{document}:{line}: {' '.join(found)}")
    return total


def print_reasons(total):
    print(f"{sum(total.values())} numbers, {total[MEASURED]} of them measured; the others:")
    for reason, count in total.most_common():
        if reason != MEASURED:
            print(f"  {count} {reason or 'without a measurement or a reason'}")


def parse_arguments():
    parser = argparse.ArgumentParser(prog="figures", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", nargs="?", default=os.path.join(PACKAGE, "build-catkin/devel/lib/semantic_topo_loop"),
                        help="folder of the programs (default: the built ones)")
    parser.add_argument("--data", default=os.environ.get("SEMANTIC_TOPO_LOOP_DATA", ""),
                        help="folder of tum/ (default: SEMANTIC_TOPO_LOOP_DATA)")
    parser.add_argument("--output", default="/tmp/semantic_topo_loop_figures", metavar="DIR",
                        help="folder for what the commands write (default: %(default)s)")
    parser.add_argument("--quick", action="store_true",
                        help=f"only measurements that take less than {QUICK_S:.0f} s on idle cores")
    parser.add_argument("--only", nargs="+", default=[""], metavar="TEXT", help="only measurements whose names contain one")
    parser.add_argument("--keep", action="store_true", help="run nothing: compare with what was measured before")
    parser.add_argument("--write", action="store_true", help="put today's figures into the documents")
    parser.add_argument("--list", action="store_true",
                        help="measure nothing: how many numbers are measured, why others are not, which have no reason")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N",
                        help="measurements at the same time (default: %(default)s)")
    arguments = parser.parse_args()
    arguments.programs, arguments.output = os.path.abspath(arguments.programs), os.path.abspath(arguments.output)
    return arguments


def measure_all(measurements, arguments):
    """What runs alone first, then several at a time, the longest first. @return name, and the folder and seconds or the
    failure"""
    for is_alone, jobs in (True, 1), (False, arguments.jobs):
        names = [name for name, entry in measurements.items() if entry.get("alone", False) == is_alone]
        with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
            by_length = sorted(names, key=lambda name: -measurements[name]["seconds"])
            pending = {name: pool.submit(measure, name, measurements[name]["commands"], arguments) for name in by_length}
            for name in names:
                yield name, pending[name]


def chosen_of(measurements, arguments):
    chosen = {name: entry for name, entry in measurements.items()
              if any(text in name for text in arguments.only) and not (arguments.quick and entry["seconds"] >= QUICK_S)}
    if not chosen:
        raise Failure("no measurement's name contains " + " or ".join(arguments.only))
    for name, entry in chosen.items():
        if not arguments.data and any("$DATA" in command for command in entry["commands"]):
            raise Failure(f"{name} needs the recorded sequences (--data, SEMANTIC_TOPO_LOOP_DATA)")
    return chosen


def run(arguments):
    """@return exit code"""
    with open(os.path.join(PACKAGE, "docs/figures.json")) as file:
        listed = json.load(file)
    texts = {}
    for document in DOCUMENTS:
        with open(os.path.join(PACKAGE, document)) as file:
            texts[document] = file.read()
    measurements = listed["measurements"]
    templates = {name: templates_of(entry) for name, entry in measurements.items()}
    reasons = count_reasons(texts, [t for some in templates.values() for t in some], listed["not_measured"])
    if arguments.list:
        print_reasons(reasons)
        return 1 if reasons[""] else 0
    differ = total = failed = 0
    for name, pending in measure_all(chosen_of(measurements, arguments), arguments):
        try:
            folder, seconds = pending.result()
            print(f"{name}: {seconds:.0f} s", flush=True)
            values = values_of(folder)
            for template in templates[name]:
                texts[template.document], numbers, others = compare(template, values, texts[template.document])
                total, differ = total + numbers, differ + others
        except Failure as failure:  # the others are measured all the same
            failed += 1
            print(f"{name}: error: {failure}", flush=True)
    if arguments.write:
        for document, text in texts.items():
            with open(os.path.join(PACKAGE, document), "w") as file:
                file.write(text)
    print_reasons(reasons)
    print(f"{total} numbers measured, {differ} differ" + (f"; {failed} measurements failed" if failed else ""))
    return 1 if differ or failed else 0


def main():
    arguments = parse_arguments()
    try:
        sys.exit(run(arguments))
    except Failure as failure:
        sys.exit(f"figures: error: {failure}")


if __name__ == "__main__":
    main()
