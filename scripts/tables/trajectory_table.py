"""Table IV: trajectories before and after loops and pose graph."""

import math
import os

import paper_figures
from association_tables import markdown
from inputs import LEVELS, RESTART_SEEDS, drifted, restarted
from runs import GRAPH

STATISTICS = ("rmse", "mean", "median")
REAL_COLUMNS = ("sequence, odometry", "", "poses", "ATE RMSE, m", "mean", "median", "RMSE with scale",
                "RPE over 1 s RMSE, m", "mean", "median", "RMSE, deg", "mean", "median")
PAPER_COLUMNS = ("sequence", "ATE, m", *(f"paper: {name}" for name in paper_figures.TRAJECTORY_METHODS),
                 "odometry here", "after loops here")
ODOMETRIES = {"fr2_desk": "ORB-SLAM2 (RGB-D)", "fr3_office": "true poses"}
DRIFT_COLUMNS = ("sequence", "file", "ATE before, m", "after, m", "ratio", "mean after, m", "median after, m",
                 "RPE before", "after")

NOTES = """ATE after alignment by SE(3) as TUM's tool does, associated within 0.02 s; "with scale": aligned by a
similarity. RPE over 1 s. No ORB-SLAM2 trajectory of fr3_office is at hand: its undrifted row has the true poses as
odometry and tells only what the loops cost a perfect one. A ratio above 1 is a gain.
"""


class Comparison:
    """A run's odometry and its optimised trajectory against the truth."""

    def __init__(self, context, sequence):
        self.sequence = sequence
        self.run = context.programs.successful_run(sequence, GRAPH)
        self.before, self.after = (context.programs.trajectory(path, sequence.ground_truth)
                                   for path in (sequence.trajectory, self.run.trajectory))

    @property
    def ratio(self):
        return self.before["ate_m"]["rmse"] / self.after["ate_m"]["rmse"]


def real_rows(context, comparison):
    sequence = comparison.sequence
    title = f"{sequence.name}, {ODOMETRIES.get(sequence.name, 'odometry')}"
    for when, path, figures in (("before", sequence.trajectory, comparison.before),
                                ("after", comparison.run.trajectory, comparison.after)):
        scaled = context.programs.trajectory(path, sequence.ground_truth, "--scale")
        yield [title, when, figures["pairs"], *(f"{figures['ate_m'][key]:.4f}" for key in STATISTICS),
               f"{scaled['ate_m']['rmse']:.4f}", *(f"{figures['rpe_m'][key]:.4f}" for key in STATISTICS),
               *(f"{figures['rpe_deg'][key]:.3f}" for key in STATISTICS)]


def paper_rows(comparison):
    """Table IV as the paper has it, with the odometry given here and what comes of it."""
    sequence = comparison.sequence
    for key in STATISTICS:
        paper = paper_figures.TRAJECTORIES.get((sequence.name, key),
                                               (None,) * len(paper_figures.TRAJECTORY_METHODS))
        yield [sequence.name, key.upper() if key == "rmse" else key, *map(paper_figures.cell, paper),
               *(f"{figures['ate_m'][key]:.4f}" for figures in (comparison.before, comparison.after))]


def relative(figures):
    return f"{figures['rpe_m']['rmse']:.4f} m, {figures['rpe_deg']['rmse']:.2f} deg"


def comparison_row(name, comparison):
    title = os.path.splitext(os.path.basename(comparison.sequence.trajectory))[0]
    after = comparison.after["ate_m"]
    return [name, title, f"{comparison.before['ate_m']['rmse']:.4f}", f"{after['rmse']:.4f}", f"{comparison.ratio:.2f}",
            f"{after['mean']:.4f}", f"{after['median']:.4f}", relative(comparison.before), relative(comparison.after)]


def geometric_mean(values):
    return math.exp(sum(map(math.log, values)) / len(values))


def level_rows(comparisons):
    """@param comparisons (sequence name, level, Comparison)"""
    names = list(dict.fromkeys(name for name, _, _ in comparisons))
    for level in LEVELS:
        for title, chosen in [(name, (name,)) for name in names] + [("all", names)]:
            ratios = [c.ratio for name, other, c in comparisons if other == level and name in chosen]
            if ratios:
                yield [level, title, len(ratios), f"{geometric_mean(ratios):.2f}", f"{min(ratios):.2f}"]


def pictures(context, comparisons):
    """Markdown of one plot a comparison."""
    if not context.pictures:
        return ""
    # Needs matplotlib, which the tables do not.
    import trajectory_pictures

    names = []
    for comparison in comparisons:
        names.append(f"{comparison.sequence.name}_trajectory.png")
        trajectory_pictures.save(comparison, os.path.join(context.output, names[-1]))
    return "".join(f"![{name[:-4]}]({name})\n" for name in names)


def table_4(context):
    real = [Comparison(context, sequence) for sequence in context.sequences]
    drift = [(sequence.name, level, Comparison(context, other)) for sequence in context.sequences
             for level, other in drifted(sequence)]
    restarts = [(sequence.name, Comparison(context, restarted(context, sequence, seed)))
                for sequence in context.sequences for seed in RESTART_SEEDS]
    parts = ["### Table IV: trajectories before and after\n",
             markdown(PAPER_COLUMNS, [row for comparison in real for row in paper_rows(comparison)]),
             markdown(REAL_COLUMNS, [row for comparison in real for row in real_rows(context, comparison)])]
    if drift:
        parts += ["**Drifted odometry, ratio of ATE before to after**\n",
                  markdown(("level", "sequence", "files", "geometric mean", "least"), level_rows(drift)),
                  markdown(DRIFT_COLUMNS, [comparison_row(name, comparison) for name, _, comparison in drift])]
    parts += ["**Undrifted odometry restarted in the middle by a random SE(3)**\n",
              markdown(DRIFT_COLUMNS, [comparison_row(name, comparison) for name, comparison in restarts]), NOTES,
              pictures(context, [*real, *(c for _, _, c in drift), *(c for _, c in restarts)])]
    return "\n".join(parts)
