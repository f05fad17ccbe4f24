"""Objects from detections that were made worse, and from fewer frames."""

import dataclasses
import os

from association_tables import FULL, PLAIN, markdown, ratio
from inputs import thinned
from runs import JDA, JOINT

SEEDS = (1, 2, 3, 4, 5)
SHARES = ("--drop", "0.3", "--relabel", "0.1", "--jitter", "0.03")
FRAME_STEP = 5
METHODS = ((JDA, "JDA"), (PLAIN, "2D + merging + confirmation (plain baseline)"),
           (FULL, "MLV-ODA, the paper's cascade"), (JOINT, JOINT.title))


def corrupted(context, sequence, seed):
    """The sequence with worse detections."""
    name = f"{sequence.name}_corrupted_{seed}"
    path = os.path.join(context.inputs, name + os.path.splitext(sequence.detections)[1])
    context.programs.perturb_detections(sequence.detections, path, "--seed", str(seed), *SHARES)
    return dataclasses.replace(sequence, name=name, detections=path)


def row(title, runs):
    failed = [run for run in runs if run.problem]
    if failed:
        return [title, "not available", *["-"] * 4]
    figures = [run.objects["certain"] for run in runs]

    def pooled(name):
        right, total = (sum(f[name][key] for f in figures) for key in ("right", "total"))
        return ratio({"right": right, "total": total, "value": right / total if total else 0.0})

    values = [f["f"] for f in figures]
    return [title, len(runs), pooled("precision"), pooled("recall"), f"{sum(values) / len(values):.3f}",
            f"{min(values):.3f}"]


def table_robustness(context):
    parts = ["### Robustness\n"]
    columns = ("method", "runs", "precision", "recall", "mean F", "least F")
    for sequence in context.sequences:
        if not sequence.reference:
            continue
        worse = [corrupted(context, sequence, seed) for seed in SEEDS]
        few = thinned(context, sequence, FRAME_STEP)
        parts.append(f"**{sequence.name}, 30 % of the boxes dropped, 10 % relabelled, corners jittered by 3 %**\n")
        parts.append(markdown(columns, [row(title, [context.programs.run(s, method) for s in worse])
                                        for method, title in METHODS]))
        parts.append(f"**{sequence.name}, every {FRAME_STEP}th frame**\n")
        parts.append(markdown(columns, [row(title, [context.programs.run(few, method)]) for method, title in METHODS]))
    parts.append("Counts are summed over the runs (seeds 1 to 5 of `perturb`).\n")
    return "\n".join(parts)
