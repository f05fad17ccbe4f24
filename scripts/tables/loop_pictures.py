"""Pictures of Table III: precision-recall curves, and reference and found loops."""

import os

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from inputs import UNDRIFTED
from paper_figures import CRITERIA
from runs import GRAPH, read_rows

COLORS = {"loops_paper": "#1b9e77", "joint": "#1f5fb4"}
INPUT_COLORS = ("black", "#1f5fb4", "#e08214", "#c51b3a")  # no drift, and the levels
REFERENCE_COLORS = {"objects": "0.88", "paper": "0.68", "original": "0.45"}
REFERENCE_NAMES = {"objects": "> 2 common objects, 500", "paper": "3 m, 80 deg, 1000", "original": "1 m, 53 deg, 1000"}


def draw_curve(axes, curve, color, numerators, denominators, accepted):
    """A line of recall and precision; a ring where the detector itself is.
    @param accepted (precision, recall) as (right, total) each"""
    points = [p for p in curve.points() if p[denominators[0]] > 0 and p[denominators[1]] > 0]
    precision, recall = ([p[n] / p[d] for p in points] for n, d in zip(numerators, denominators))
    axes.plot(recall, precision, color=color, linewidth=1.4,
              label=curve.group.title + ("" if points else ": no candidate"))
    if all(total for _, total in accepted):
        axes.plot(accepted[1][0] / accepted[1][1], accepted[0][0] / accepted[0][1], marker="o", markersize=6,
                  color=color, markerfacecolor="white", markeredgewidth=1.5, linestyle="", zorder=4)


def draw_by_criterion(axes, curve, color):
    counts = curve.group.table("paper")
    right = counts["true_positives"]
    draw_curve(axes, curve, color, ("true_positives", "true_positives"), ("real_loops", "reference_loops"),
               ((right, counts["real_loops"]), (right, counts["reference_loops"])))


def draw_by_pose(axes, curve, color):
    draw_curve(axes, curve, color, ("right_wide", "closed_queries"), ("judged", "loopable_queries"),
               [(r["right"], r["total"]) for r in map(curve.group.pooled, ("right_wide", "closed"))])


def frame(axes, title, x_label):
    axes.plot([], [], marker="o", color="0.3", markerfacecolor="white", linestyle="", label="the detector's own choice")
    axes.set_xlim(-0.01, 1.02)
    axes.set_ylim(-0.01, 1.03)
    axes.grid(color="0.92")
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x_label, fontsize=9)
    axes.set_ylabel("precision", fontsize=9)
    axes.legend(loc="lower left", fontsize=8)


def save_curves(sequence, curves, path):
    figure, grid = plt.subplots(2, 2, figsize=(12.0, 10.0), dpi=110)
    by_method = {}
    for curve in curves:
        by_method.setdefault(curve.group.method, []).append(curve)
    panels = [(method, draw_by_criterion, "by the paper's criterion", "recall of reference loops, one loop a keyframe")
              for method in by_method]
    panels.append((GRAPH, draw_by_pose, "right within 0.35 m / 10 deg", "share of loopable queries closed"))
    for axes, (method, draw, title, x_label) in zip(grid.flat, panels):
        for curve, color in zip(by_method[method], INPUT_COLORS):
            draw(axes, curve, color)
        frame(axes, f"{method.title}: {title}", x_label)
    figure.suptitle(f"{sequence.name}: every recorded candidate from a score on, whatever else was tested", fontsize=12)
    figure.subplots_adjust(top=0.92, hspace=0.24, wspace=0.16)
    figure.savefig(path, bbox_inches="tight")
    plt.close(figure)


def save_reference_loops(sequence, graph, paper, path):
    figure, (pairs, counts, angles) = plt.subplots(1, 3, figsize=(17.5, 5.6), dpi=110,
                                                   gridspec_kw={"width_ratios": (1.15, 1.0, 1.0)})
    references = read_rows(os.path.join(graph.runs[0].details, "reference_pairs.csv"))
    draw_pairs(pairs, references, graph, paper)
    draw_counts(counts, graph, paper)
    draw_angles(angles, references, graph, paper)
    figure.suptitle(f"{sequence.name}, {UNDRIFTED}: reference loops of the keyframes and loops found", fontsize=11)
    figure.subplots_adjust(wspace=0.22)
    figure.savefig(path, bbox_inches="tight")
    plt.close(figure)


def draw_pairs(axes, references, graph, paper):
    for key in ("objects", "paper", "original"):
        chosen = [row for row in references if row[key] == "1"]
        axes.plot([int(row["query_image"]) for row in chosen], [int(row["match_image"]) for row in chosen], marker="s",
                  markersize=3, linestyle="", color=REFERENCE_COLORS[key], label=f"reference: {REFERENCE_NAMES[key]}")
    for group, marker, size in ((graph, "o", 3.5), (paper, "^", 5.0)):
        loops = group.judged_loops()
        right = [float(row["error_m"]) <= 0.35 and float(row["error_deg"]) <= 10.0 for row in loops]
        for wanted, name, color in ((True, "right", COLORS[group.method.key]), (False, "wrong", "red")):
            chosen = [row for row, is_right in zip(loops, right) if is_right == wanted]
            if chosen:
                axes.plot([int(row["query_image"]) for row in chosen], [int(row["match_image"]) for row in chosen],
                          marker=marker, markersize=size, linestyle="", color=color, markeredgewidth=0.0,
                          label=f"{group.method.title}: {name} by pose")
    axes.set_xlabel("query, image")
    axes.set_ylabel("match, image")
    axes.set_title("pairs of keyframes", fontsize=10)
    axes.legend(fontsize=7, loc="upper left")


def draw_counts(axes, graph, paper):
    names = ("keyframes", "reference_loops", "real_loops", "true_positives")
    columns = [(key, group) for key, _ in CRITERIA for group in (paper, graph)]
    width = 0.8 / len(names)
    for i, name in enumerate(names):
        values = [group.table(key)[name] for key, group in columns]
        bars = axes.bar(np.arange(len(columns)) + (i - 1.5) * width, values, width, label=name.replace("_", " "),
                        color=("0.85", "0.6", "#7fb2e5", "#1f5fb4")[i])
        for bar, value in zip(bars, values):
            axes.annotate(str(value), (bar.get_x() + 0.5 * width, value), ha="center", va="bottom", fontsize=6)
    axes.set_xticks(range(len(columns)))
    axes.set_xticklabels([f"{REFERENCE_NAMES[key]}\n{group.method.title}" for key, group in columns], fontsize=6.5,
                         rotation=30, ha="right")
    axes.set_title("Table III in numbers", fontsize=10)
    axes.margins(y=0.18)
    axes.legend(fontsize=7, loc="upper left", ncol=2)


def draw_angles(axes, references, graph, paper):
    edges = np.arange(0.0, 181.0, 15.0)
    sources = [("reference pairs, " + REFERENCE_NAMES[key],
                [float(row["axes_deg"]) for row in references if row[key] == "1"], color)
               for key, color in (("objects", "0.75"), ("paper", "0.35"))]
    sources += [(f"accepted, {group.method.title}", [float(row["axes_deg"]) for row in group.judged_loops()],
                 COLORS[group.method.key]) for group in (paper, graph)]
    for name, values, color in sources:
        if not values:
            continue
        shares = np.histogram(values, edges)[0] / len(values)
        axes.step(edges, np.append(shares, shares[-1]), where="post", color=color, linewidth=1.8,
                  label=f"{name} ({len(values)})")
    axes.set_xlim(0.0, 180.0)
    axes.set_xticks(edges[::2])
    axes.grid(color="0.92")
    axes.set_xlabel("angle between the optical axes, deg")
    axes.set_ylabel("share of pairs")
    axes.set_title("how different the two views are", fontsize=10)
    axes.legend(fontsize=7, loc="upper right")
