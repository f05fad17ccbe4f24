"""Objects in the last correction, as is the default, against loops alone, on every odometry file."""

from association_tables import markdown
from inputs import LEVELS, RESTART_SEEDS, level_of, replaced, restarted
from runs import GRAPH, Method
from trajectory_table import geometric_mean

LOOPS_ALONE = Method("loops_alone", "loops alone", ("pose_graph.objects=off",))
COLUMNS = ("files of", "level", "sequence", "files", "loops alone", "with objects", "ATE with / without", "least", "most",
           "more than 1 % worse")

NOTES = """Loops alone, with objects: ATE before / after, geometric mean. With / without: ATE after with objects over ATE after
with loops alone, geometric mean, and its least and most.
"""


def ates_m(context, sequence):
    """RMSE of the odometry, after loops, and after loops and objects."""
    programs = context.programs
    paths = (sequence.trajectory, *(programs.successful_run(sequence, method).trajectory for method in (LOOPS_ALONE, GRAPH)))
    return [programs.trajectory(path, sequence.ground_truth)["ate_m"]["rmse"] for path in paths]


def inputs_of(context, sequence):
    """((folder, level), sequence) for every odometry."""
    yield ("undrifted", "-"), sequence
    for folder, paths in (("drifted", sequence.drifted), ("drifted_real", sequence.drifted_real)):
        for path in paths:
            yield (folder, level_of(path)), replaced(sequence, path)
    for seed in RESTART_SEEDS:
        yield ("restarted", "-"), restarted(context, sequence, seed)


def row(key, title, ates):
    ratios = [with_objects / alone for _, alone, with_objects in ates]
    return [*key, title, len(ates), *(f"{geometric_mean([a[0] / a[i] for a in ates]):.1f} x" for i in (1, 2)),
            f"{geometric_mean(ratios):.2f}", f"{min(ratios):.2f}", f"{max(ratios):.2f}",
            sum(ratio > 1.01 for ratio in ratios)]


def table_objects(context):
    ates = [(key, sequence.name, ates_m(context, other)) for sequence in context.sequences
            for key, other in inputs_of(context, sequence)]
    keys = [("undrifted", "-"), *((folder, level) for folder in ("drifted", "drifted_real") for level in LEVELS),
            ("restarted", "-")]
    names = [sequence.name for sequence in context.sequences]
    rows = []
    for key in keys:
        for title, chosen in [(name, (name,)) for name in names] + [("all", names)]:
            some = [figures for other, name, figures in ates if other == key and name in chosen]
            if some:
                rows.append(row(key, title, some))
    return ("### Objects in the correction\n\n**ATE with objects in the correction**\n\n" + markdown(COLUMNS, rows) + "\n" +
            NOTES)
