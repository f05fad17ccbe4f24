"""Tables I and II (objects by sequence, by association method, and by its levels) and the timing table."""

import os
import statistics

import paper_figures
from runs import FULL_LEVELS, JDA, JOINT, LEVELS, bare, cascade, read_rows

FULL = cascade(FULL_LEVELS)
PLAIN = cascade("2d")

PAPER_COLUMNS = ("sequence", "method", "frames", "constructed", "real", "true positive", "precision", "recall", "F",
                 "paper: frames", "constructed", "real", "true positive", "precision", "recall", "F")
OBJECT_COLUMNS = ("method", "merging, confirmation", "objects", "merges", "precision", "recall", "F", "F, strict",
                  "F, paper's rule", "paper: constructed", "true positive", "precision", "recall", "F")
STAGES = (10, 100, 1000)  # frames

PAPER_NOTES = (
    "Real: the certain reference objects; true positive: those found (same class, centre within max(0.15 m, half the "
    "largest semi-axis), one to one). Constructed objects that are a probable or marginal reference are neither right "
    "nor wrong, so that precision counts fewer than are constructed. fr1_xyz (from its images, with depth) is no "
    "sequence of the paper's.")

OBJECT_NOTES = (
    "Objects: confirmed landmarks. Merging, confirmation off: every ellipsoid counts and nothing is merged. "
    "Precision and recall against the certain reference objects (same class, centre within max(0.15 m, half "
    "the largest semi-axis), one to one; probable and marginal references are neither right nor wrong); strict: "
    "probable ones are required and everything else unmatched is wrong; paper's rule: an object is right if no other "
    "constructed object is nearby, with the recall of the certain ones. The reference was triangulated from the same "
    "detections, so the figures tell consistency, not truth.")


def markdown(columns, rows):
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"


def ratio(figures):
    return f"{figures['value']:.3f} ({figures['right']}/{figures['total']})"


def harmonic_mean(a, b):
    return 2.0 * a * b / (a + b) if a + b > 0.0 else 0.0


def object_row(run, title, rules):
    paper = paper_figures.ablation_cells(run.sequence.name, run.method.key)
    if run.problem:
        return [title, rules, "not available", *["-"] * 6, *paper]
    counts = [run.summary["landmarks"].get("confirmed", 0), run.summary.get("merges", 0)]
    e = run.objects
    if not e:
        return [title, rules, *counts, *["-"] * 5, *paper]
    paper_rule = harmonic_mean(e["undisputed"]["value"], e["certain"]["recall"]["value"])
    return [title, rules, *counts, ratio(e["certain"]["precision"]), ratio(e["certain"]["recall"]),
            f"{e['certain']['f']:.3f}", f"{e['strict']['f']:.3f}", f"{paper_rule:.3f}", *paper]


def object_table(context, entries):
    """@param entries (method, title, whether merging and confirmation are on)"""
    parts = []
    for sequence in context.sequences:
        rows = [object_row(context.programs.run(sequence, method), title, "on" if rules else "off")
                for method, title, rules in entries]
        parts.append(f"**{sequence.name}**" + ("" if sequence.reference else " (no reference: counts only)") + "\n\n" +
                     markdown(OBJECT_COLUMNS, rows))
    return "\n".join(parts) + "\n" + OBJECT_NOTES + "\n"


def paper_row(run, title):
    """Table I as the paper has it."""
    name = run.sequence.name
    paper = paper_figures.object_cells(paper_figures.OBJECTS.get(name))
    if run.problem:
        return [name, title, "not available", *["-"] * 6, *paper]
    figures = run.objects.get("certain")
    ours = ["-"] * 5
    if figures:
        precision, recall = figures["precision"], figures["recall"]
        ours = [recall["total"], recall["right"], ratio(precision), ratio(recall), f"{figures['f']:.3f}"]
    return [name, title, run.summary["frames"], run.summary["landmarks"].get("confirmed", 0), *ours, *paper]


def paper_table(context):
    sequences = [*context.sequences, *context.image_sequences]
    rows = [paper_row(context.programs.run(sequence, method), title) for sequence in sequences
            for method, title in ((FULL, "MLV-ODA, the paper's cascade"), (JOINT, JOINT.title))]
    there = {sequence.name for sequence in sequences}
    rows += [[name or "the paper's average", "-", *["-"] * 7, *paper_figures.object_cells(figures)]
             for name, figures in paper_figures.OBJECTS.items() if name not in there]
    return markdown(PAPER_COLUMNS, rows) + "\n" + PAPER_NOTES + "\n\n"


def table_1(context):
    entries = [
        (JDA, "JDA (the paper's baseline)", True),
        (bare(PLAIN), "2D only", False),
        (PLAIN, "2D + merging + confirmation (plain baseline)", True),
        (bare(FULL), "MLV-ODA, the paper's cascade", False),
        (FULL, "MLV-ODA, the paper's cascade", True),
        (bare(JOINT), JOINT.title, False),
        (JOINT, JOINT.title, True),
    ]
    return ("### Table I: objects\n\n" + paper_table(context) + "### Table I, by association method\n\n" +
            object_table(context, entries))


def table_2(context):
    entries = [(method, method.title, rules) for rules in (True, False)
               for method in (cascade(levels) if rules else bare(cascade(levels)) for levels in LEVELS)]
    ablation = paper_figures.ABLATION
    names = ", ".join(f"{ablation[method.key][0]} ({method.title})" for method in map(cascade, LEVELS)
                      if method.key in ablation)
    return ("### Table II: ablation of the cascade's levels\n\n" + object_table(context, entries) +
            "The upper half of each table has the default mapping rules, the lower half neither merges nor confirms: "
            "what differs between rows of one half comes from the levels, what differs between the halves from merging "
            "and confirmation. Level 3 alone needs map points or depth: from boxes only, no landmark gets a second "
            f"view. The paper's figures are of {paper_figures.ABLATION_REAL} real objects of "
            f"{paper_figures.ABLATION_SEQUENCE}, its names {names}.\n")


def read_times(run, column):
    return [float(row[column]) for row in read_rows(os.path.join(run.directory, "timing.csv"))]


def percentile(values, share):
    """The smallest value that at least this share does not exceed."""
    ordered = sorted(values)
    return ordered[max(0, -(-len(ordered) * share // 100) - 1)]


def timing_row(run, title):
    if run.problem:
        return [run.sequence.name, title, "not available", *["-"] * 5]
    association, mapping = read_times(run, "association_us"), read_times(run, "mapping_us")
    return [run.sequence.name, title, len(association), f"{statistics.median(association):.1f}",
            f"{percentile(association, 99):.1f}", f"{statistics.mean(association):.1f}",
            f"{statistics.mean(mapping):.1f}", f"{run.times_real_time:.1f} x"]


def stage_rows(context):
    """The paper's timing: mean association time over the first frames."""
    for sequence in context.sequences:
        times = [read_times(context.programs.successful_run(sequence, method), "association_us")
                 for method in (JDA, FULL, JOINT)]
        for frames in STAGES:
            jda, cascade_ms, joint = (f"{statistics.mean(values[:frames]) / 1000:.4f}" for values in times)
            paper = paper_figures.ASSOCIATION_MS.get((sequence.name, frames), (None, None))
            paper_jda, paper_cascade = map(paper_figures.cell, paper)
            yield [sequence.name, frames, jda, paper_jda, cascade_ms, paper_cascade, joint]


def table_timing(context):
    rows = [timing_row(context.programs.run(sequence, method), title) for sequence in context.sequences
            for method, title in ((JDA, "JDA"), (FULL, "MLV-ODA, the paper's cascade"), (JOINT, JOINT.title))]
    columns = ("sequence", "method", "frames", "association median, us", "p99, us", "mean, us", "mapping mean, us",
               "whole run")
    stages = ("sequence", "frames", "JDA, ms", "paper: JDA, ms", "MLV-ODA, ms", "paper: MLV-ODA, ms", JOINT.title + ", ms")
    return (f"### Time a frame\n\nMachine: {machine()}; the paper's: {paper_figures.ASSOCIATION_MACHINE}. Mean "
            "association time of a frame over the first 10, 100 and 1000:\n\n" + markdown(stages, stage_rows(context)) +
            "\n" + markdown(columns, rows) +
            "\nAssociation includes undistortion, index update and assignment; mapping includes refinement; the whole "
            "run includes loop detection and pose graph.\n")


def machine():
    name, count = "unknown processor", os.cpu_count()
    try:
        with open("/proc/cpuinfo") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
        name = names[0] if names else name
    except OSError:
        pass
    return f"{name}, {count} processors"
