"""Measures again what the documents state and says which figures differ; ends with 0 if none does.

docs/figures.json lists measurements - commands that write files into a folder of their own - and, for each, lines of
documents with {expressions} in place of the figures. An expression is Python over what the commands wrote: NAME.json by
its name (`after.ate_m.rmse`), and cells of the tables that paper_tables printed, `cell(heading, row..., column)`. `{~...}`
is a time, or hangs on one: it is shown and never compared. A line that does not stand in its document once is an error."""

import argparse
import glob
import json
import os
import re
import shlex
import subprocess
import sys
import time
from types import SimpleNamespace

from runs import Failure, package_folder

PACKAGE = package_folder()
DOCUMENTS = ("README.md", "docs/benchmarks.md")
PLACE = re.compile(r"\{(~?)([^{}]+?)(?::([.,\d]*[a-z%]))?\}")
NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?")
QUICK_S = 60.0


class Template:
    """A line of a document with expressions in place of its figures."""

    def __init__(self, document, text):
        self.document, self.text = document, text
        self.places = list(PLACE.finditer(text))
        ends = [0] + [end for place in self.places for end in place.span()] + [len(text)]
        fixed = [re.escape(text[ends[i]:ends[i + 1]]) for i in range(0, len(ends), 2)]
        is_row = text.startswith("|") and text.endswith("|")
        whole = r"^%s$" if is_row else "%s"
        self._pattern = re.compile(whole % r"([^|\n]+?)".join(fixed), re.MULTILINE)

    def find(self, document_text):
        """@return the one place where it stands"""
        found = list(self._pattern.finditer(document_text))
        if len(found) != 1:
            raise Failure(f"{self.document} has {len(found)} times, not once: {self.text}")
        return found[0]

    def figures(self, values):
        """(figure as text, whether it is compared) of each place."""
        for place in self.places:
            is_shown_only, expression, layout = place.groups()
            try:
                value = eval(expression, {}, values)
            except Exception as error:  # whatever the commands wrote
                raise Failure(f"{expression} in '{self.text}': {error!r}")
            yield format(value, layout or ""), not is_shown_only


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

    def cell(self, heading, *row_and_column):
        *row, column = row_and_column
        for above, columns, rows in self._tables:
            for cells in rows if heading in above else []:
                if cells[:len(row)] == row:
                    return cells[columns.index(column)]
        raise KeyError((heading, *row_and_column))


def values_of(folder):
    """Names that the expressions of a measurement may use."""
    values = {"ratio": ratio, "spaced": spaced}
    for path in glob.glob(os.path.join(folder, "*.json")):
        with open(path) as file:
            values[os.path.basename(path)[:-5]] = namespace(json.load(file))
    tables = os.path.join(folder, "tables.md")
    if os.path.exists(tables):
        with open(tables) as file:
            values["cell"] = Tables(file.read()).cell
    return values


def measure(name, commands, arguments):
    """Runs the commands of a measurement. @return its folder, seconds"""
    folder = os.path.join(arguments.output, name)
    os.makedirs(folder, exist_ok=True)
    begin = time.monotonic()
    for command in commands if not arguments.keep else []:
        words = [word.replace("$DATA", arguments.data).replace("$OUT", folder).replace("$CONFIG", PACKAGE + "/config")
                 .replace("$PROGRAMS", arguments.programs) for word in shlex.split(command)]
        in_scripts = os.path.join(PACKAGE, words[0])
        words[0] = in_scripts if words[0].startswith("scripts/") else os.path.join(arguments.programs, words[0])
        result = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True)
        if result.returncode != 0:
            raise Failure(f"{shlex.join(words)}: {result.stderr.strip()[-2000:]}")
    return folder, time.monotonic() - begin


def compare(template, values, text):
    """@return the document's text with today's figures, and how many of them differ"""
    found = template.find(text)
    others, times, parts, end = [], [], [], found.start()
    for i, (now, is_compared) in enumerate(template.figures(values), 1):
        stated = found.group(i)
        if stated != now:
            (others if is_compared else times).append(f"{stated} is {now}")
        parts += [text[end:found.start(i)], now if is_compared else stated]
        end = found.end(i)
    for kind, changes in (("differs", others), ("times, not compared", times)):
        if changes:
            print(f"  {template.document}: {kind}: {', '.join(changes)}; in: {found.group(0)}")
    return text[:found.start()] + "".join(parts) + text[end:], len(others), len(template.places)


def list_uncovered(texts, templates):
    """Numbers of the documents that no template has; code is left out."""
    for document, text in texts.items():
        covered = [t.find(text).span() for t in templates if t.document == document]
        code = [match.span() for match in re.finditer(r"```.*?```|`[^`\n]*`|\]\([^)\n]*\)", text, re.DOTALL)]
        numbers = [m for m in NUMBER.finditer(text) if not any(a <= m.start() < b for a, b in code)]
        missing = [m for m in numbers if not any(a <= m.start() < b for a, b in covered)]
        lines = {}
        for m in missing:
            lines.setdefault(text.count("\n", 0, m.start()) + 1, []).append(m.group())
        for line, found in lines.items():
            print(f"{document}:{line}: {' '.join(found)}")
        print(f"{document}: {len(numbers) - len(missing)} of {len(numbers)} numbers are in lines that are measured again")


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
    parser.add_argument("--only", default="", metavar="TEXT", help="only measurements whose name contains it")
    parser.add_argument("--keep", action="store_true", help="run nothing: compare with what was measured before")
    parser.add_argument("--write", action="store_true", help="put today's figures, times aside, into the documents")
    parser.add_argument("--list", action="store_true", help="show the documents' numbers that nothing measures again")
    arguments = parser.parse_args()
    arguments.programs, arguments.output = os.path.abspath(arguments.programs), os.path.abspath(arguments.output)
    return arguments


def main():
    arguments = parse_arguments()
    with open(os.path.join(PACKAGE, "docs/figures.json")) as file:
        measurements = json.load(file)
    texts = {}
    for document in DOCUMENTS:
        with open(os.path.join(PACKAGE, document)) as file:
            texts[document] = file.read()
    differ = total = 0
    try:
        templates = {name: [Template(document, line) for document, lines in entry["lines"].items() for line in lines]
                     for name, entry in measurements.items()}
        for template in (t for chosen in templates.values() for t in chosen):
            template.find(texts[template.document])
        if arguments.list:
            list_uncovered(texts, [t for chosen in templates.values() for t in chosen])
            return
        for name, entry in measurements.items():
            if arguments.only not in name or (arguments.quick and entry["seconds"] >= QUICK_S):
                continue
            if not arguments.data and any("$DATA" in command for command in entry["commands"]):
                raise Failure(f"{name} needs the recorded sequences (--data, SEMANTIC_TOPO_LOOP_DATA)")
            folder, seconds = measure(name, entry["commands"], arguments)
            print(f"{name}: {seconds:.0f} s", flush=True)
            values = values_of(folder)
            for template in templates[name]:
                document = template.document
                texts[document], others, figures = compare(template, values, texts[document])
                differ, total = differ + others, total + figures
        if arguments.write:
            for document, text in texts.items():
                with open(os.path.join(PACKAGE, document), "w") as file:
                    file.write(text)
    except Failure as failure:
        sys.exit(f"figures: error: {failure}")
    print(f"{differ} of {total} figures differ")
    sys.exit(1 if differ else 0)


if __name__ == "__main__":
    main()
