"""Table III: loops by detection method, under the criteria of the literature and by their poses."""

import bisect
import csv
import os
import statistics

import paper_figures
from association_tables import markdown, ratio
from inputs import LEVELS, RESTART_SEEDS, UNDRIFTED, drifted, lines_of, restarted
from runs import GRAPH, PAPER_CORRECTED, PAPER_PRINTED, read_rows

METHODS = (PAPER_CORRECTED, PAPER_PRINTED, GRAPH)
COLUMNS = ("method", "input", "files", "keyframes", "reference loops", "real loops", "true positives", "precision",
           "recall", "keyframes with a reference loop", "recall of these", "found by any loop",
           "real loops right by their pose")

NOTES = """A loop is counted at its keyframes. Reference loops: pairs of keyframes that fulfil the criterion, as the paper
counts them. Real loops: keyframes with an accepted loop over the gap, one each, that of the best score; true positives:
of these, loops whose keyframes fulfil the criterion; precision and recall are true positives over real and over
reference loops. As a keyframe has one loop at most, such a recall cannot come near 1; that of the keyframes with any
reference loop can. Rows of the paper are its printed figures: none of its methods but its own is run. Graph mode
reports several loops a keyframe and closes them from the other side of a desk as well, which a limit on the viewpoint
counts as wrong: hence the share of reference loops that any of its loops finds, and the real loops whose pose is right
within 0.35 m / 10 deg (ends in holes of the motion capture left out). Common objects are the confirmed ones that the
undrifted run of the default configuration saw in both keyframes. Drifted files are summed up by level.
"""

BEYOND_COLUMNS = ("method", "input", "accepted", "right within 0.35 m / 10 deg", "least file", "0.20 m / 5 deg",
                  "median error", "queries closed", "closed at once", "revisiting pairs closed",
                  "largest viewpoint difference", "revisits closed", "median latency")

BEYOND_NOTES = """Accepted loops count here whatever their gap; judged are those with a true pose at both ends.
Queries: every 15th image that fulfils the paper's criterion with an earlier one; closed if a right loop over the gap
has it among its evidence, at once if that evidence ends within 15 frames. Revisiting pairs: of such images, both
among the evidence of an accepted loop. Viewpoint difference: angle of the rotation between the two cameras, of a
right loop. A revisit is a run of loopable queries; its latency counts from the first one to the end of the evidence
of the first right loop over the gap that is accepted from then on, while the revisit lasts.
"""


class Group:
    """The runs of one method on all files of one input, and their figures."""

    def __init__(self, context, sequence, method, title, inputs):
        sightings = context.programs.successful_run(sequence, GRAPH)
        self.method, self.title = method, title
        self.runs = [context.programs.successful_run(s, method) for s in inputs]
        self.figures = [context.programs.loops(run, sightings) for run in self.runs]

    def pooled(self, name):
        return pool(figures[name] for figures in self.figures)

    def table(self, criterion):
        """Counts of a criterion, summed."""
        rows = [row for figures in self.figures for row in figures["table"] if row["criterion"] == criterion]
        counts = {key: sum(row[key] for row in rows) for key in rows[0] if isinstance(rows[0][key], int)}
        return {**counts, "right_wide": pool(row["right_wide"] for row in rows)}

    def judged_loops(self):
        """Rows of all accepted loops with a true pose at both ends."""
        return [row for run in self.runs for row in read_rows(os.path.join(run.details, "judged_loops.csv"))
                if row["judged"] == "1" and row["accepted"] == "1"]

    def least(self, name):
        """The file with the smallest ratio, among those with loops."""
        ratios = [figures[name] for figures in self.figures if figures[name]["total"] > 0]
        return min(ratios, key=lambda r: r["value"], default=pool([]))

    def revisits(self):
        return [revisit for figures in self.figures for revisit in figures["revisits"]]


def pool(ratios):
    right = total = 0
    for figures in ratios:
        right += figures["right"]
        total += figures["total"]
    return make_ratio(right, total)


def make_ratio(right, total):
    return {"right": right, "total": total, "value": right / total if total else 0.0}


def share(figures):
    """A ratio with its counts, or a dash without any."""
    return ratio(figures) if figures["total"] else "-"


def number(figures):
    """A ratio without its counts."""
    return f"{figures['value']:.3f}" if figures["total"] else "-"


def groups_of(context, sequence):
    """@return {(method key, input): Group}, undrifted first"""
    inputs = {UNDRIFTED: [sequence]}
    for level, other in drifted(sequence):
        inputs.setdefault(level, []).append(other)
    ordered = [UNDRIFTED, *(level for level in LEVELS if level in inputs)]
    return {(method.key, title): Group(context, sequence, method, title, inputs[title])
            for method in METHODS for title in ordered}


def criterion_row(group, criterion):
    counts = group.table(criterion)
    pairs, reference, real, right = (counts[key] for key in ("reference_pairs", "reference_loops", "real_loops",
                                                             "true_positives"))
    return [group.method.title, group.title, len(group.runs), counts["keyframes"], pairs, real, right,
            number(make_ratio(right, real)), f"{right / pairs:.2%}".replace("%", " %") if pairs else "-", reference,
            number(make_ratio(right, reference)), share(make_ratio(counts["found"], reference)),
            share(counts["right_wide"])]


def criterion_table(sequence, groups, criterion, title):
    rows = [criterion_row(group, criterion) for group in groups.values()]
    rows = [[f"the paper: {row[0]}", "no drift", 1, *paper_figures.loop_cells(row), *["-"] * 4]
            for row in paper_figures.LOOPS.get((sequence.name, criterion), ())] + rows
    return f"**{sequence.name}, {title}**\n\n" + markdown(COLUMNS, rows)


def median_error(rows):
    if not rows:
        return "-"
    meters, degrees = (statistics.median(float(row[key]) for row in rows) for key in ("error_m", "error_deg"))
    return f"{meters:.3f} m, {degrees:.2f} deg"


def median_latency(revisits):
    closed = [revisit for revisit in revisits if revisit["latency_frames"] is not None]
    if not closed:
        return "-"
    return (f"{statistics.median(r['latency_frames'] for r in closed):g} frames, "
            f"{statistics.median(r['latency_s'] for r in closed):.1f} s")


def beyond_row(group):
    largest = max(figures["largest_right_view_deg"] for figures in group.figures)
    revisits = group.revisits()
    closed = sum(revisit["latency_frames"] is not None for revisit in revisits)
    return [group.method.title, group.title, sum(figures["accepted"] for figures in group.figures),
            share(group.pooled("right_wide")), share(group.least("right_wide")), share(group.pooled("right_narrow")),
            median_error(group.judged_loops()), share(group.pooled("closed")), share(group.pooled("closed_at_once")),
            share(group.pooled("pair_recall")), f"{largest:.0f} deg" if largest else "-",
            f"{closed} of {len(revisits)}", median_latency(revisits)]


def viewpoint_table(groups):
    """Graph mode only: the paper's finds hardly any loop beyond 60 deg."""
    chosen = [group for group in groups.values() if group.method is GRAPH]
    bins = chosen[0].figures[0]["by_viewpoint"]
    rows = []
    for group in chosen:
        cells, loops = [], group.judged_loops()
        for i, limits in enumerate(bins):
            is_last = i + 1 == len(bins)
            within = [row for row in loops if limits["from_deg"] <= float(row["view_deg"]) < limits["to_deg"]
                      or (is_last and float(row["view_deg"]) >= limits["to_deg"])]
            pooled = pool(figures["by_viewpoint"][i]["right_wide"] for figures in group.figures)
            cells.append(f"{pooled['right']} of {pooled['total']}; {median_error(within)}" if pooled["total"] else "-")
        rows.append([group.title, *cells])
    return markdown(["input", *(f"{b['from_deg']:g} to {b['to_deg']:g} deg" for b in bins)], rows)


class Curve:
    """Counts of a group's candidates from a score on, summed over its files."""

    COUNTS = ("true_positives", "real_loops", "reference_loops", "right_wide", "judged", "closed_queries",
              "loopable_queries")

    def __init__(self, group):
        self.group = group
        self._files = []  # of each its scores, counts before the first candidate and from each score on
        for run, figures in zip(group.runs, group.figures):
            rows = read_rows(os.path.join(run.details, "precision_recall.csv"))
            references = next(row["reference_loops"] for row in figures["table"] if row["criterion"] == "paper")
            totals = {"reference_loops": references, "loopable_queries": figures["closed"]["total"]}
            self._files.append(([-float(row["min_score"]) for row in rows],
                                [[totals.get(key, 0) for key in self.COUNTS]] +
                                [[int(row[key]) for key in self.COUNTS] for row in rows]))
        self.scores = sorted({-score for scores, _ in self._files for score in scores}, reverse=True)

    def points(self):
        """@return one {name: value} a distinct score, from the highest down"""
        for score in self.scores:
            counts = [0] * len(self.COUNTS)
            for scores, rows in self._files:
                counts = [a + b for a, b in zip(counts, rows[bisect.bisect_right(scores, -score)])]
            yield {"min_score": score, **dict(zip(self.COUNTS, counts))}


def save_curves(curves, path):
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["method", "input", "min_score", *Curve.COUNTS])
        for curve in curves:
            for point in curve.points():
                writer.writerow([curve.group.method.title, curve.group.title, f"{point['min_score']:.6f}",
                                 *(point[name] for name in Curve.COUNTS)])


def curve_files(context, sequence, groups):
    """@return names of the files with precision-recall curves and reference loops"""
    curves = [Curve(group) for group in groups.values()]
    names = [f"{sequence.name}_precision_recall.csv"]
    save_curves(curves, os.path.join(context.output, names[0]))
    if not context.pictures:
        return names
    # Needs matplotlib, which the tables do not.
    import loop_pictures

    names += [f"{sequence.name}_precision_recall.png", f"{sequence.name}_reference_loops.png"]
    loop_pictures.save_curves(sequence, curves, os.path.join(context.output, names[1]))
    loop_pictures.save_reference_loops(sequence, groups[GRAPH.key, UNDRIFTED], groups[PAPER_CORRECTED.key, UNDRIFTED],
                                       os.path.join(context.output, names[2]))
    return names


def restart_rows(context, sequence):
    """Graph mode after a restart of the odometry: loops across the break."""
    for seed in RESTART_SEEDS:
        group = Group(context, sequence, GRAPH, f"restart, seed {seed}", [restarted(context, sequence, seed)])
        with open(group.runs[0].sequence.trajectory) as file:
            middle = float(file.readlines()[group.runs[0].summary["frames"] // 2].split()[0])
        stamps = [float(line.split()[0]) for line in lines_of(sequence.frames)]
        first = bisect.bisect_left(stamps, middle - 0.005)
        across = [row for row in group.judged_loops() if int(row["match_image"]) < first <= int(row["query_image"])]
        right = [row for row in across if float(row["error_m"]) <= 0.35 and float(row["error_deg"]) <= 10.0]
        yield [sequence.name, seed, share(make_ratio(len(right), len(across))), median_error(across)]


def table_3(context):
    parts = ["### Table III: loops by detection method\n"]
    restarts = []
    for sequence in context.sequences:
        if not sequence.frames:
            context.programs.note(f"Table III leaves out {sequence.name}: it has no groundtruth_frames.txt.")
            continue
        groups = groups_of(context, sequence)
        parts += [criterion_table(sequence, groups, key, title) for key, title in paper_figures.CRITERIA]
        parts.append(f"**{sequence.name}, what the paper does not report**\n")
        parts.append(markdown(BEYOND_COLUMNS, map(beyond_row, groups.values())))
        parts.append(f"**{sequence.name}, graph mode by viewpoint difference: loops right within 0.35 m / 10 deg of "
                     "all, median error of all**\n")
        parts.append(viewpoint_table(groups))
        parts.append("".join(f"![{name[:-4]}]({name})\n" if name.endswith(".png") else f"Curves: [{name}]({name})\n"
                             for name in curve_files(context, sequence, groups)))
        restarts += restart_rows(context, sequence)
    parts.append("**Odometry restarted in the middle by a random SE(3): graph mode's loops across the break**\n")
    parts.append(markdown(("sequence", "seed", "right within 0.35 m / 10 deg", "median error"), restarts))
    return "\n".join(parts) + "\n" + NOTES + "\n" + BEYOND_NOTES
