"""What the default configuration makes of every odometry file that is there, drifted or not."""

import os
import statistics
from dataclasses import dataclass

from association_tables import markdown
from inputs import LEVELS, UNDRIFTED, level_of, replaced, thinned
from loop_table import pool, share
from runs import GRAPH
from trajectory_table import geometric_mean

FOLDERS = ("drifted", "drifted_real")
FRAME_STEP = 3  # of the thinned files
THINNED = f"drifted_real, every {FRAME_STEP}rd frame"
KINDS = ("freeze", "scale", "slip", "walk")
COLUMNS = ("sequence", "file", "ATE before, m", "after, m", "ratio", "objects F", "right within 0.35 m / 10 deg",
           "queries closed")
KIND_COLUMNS = ("files of", "sequence", "level", *KINDS, "all")
LEVEL_COLUMNS = ("files of", "level", "sequence", "files", "geometric mean", "least", "median ATE after, m",
                 "right within 0.35 m / 10 deg", "queries closed")

NOTES = """ATE RMSE after alignment by SE(3); ratio: before / after. Objects F against the certain reference objects.
"""


@dataclass
class Row:
    sequence: str
    file: str  # without its ending
    folder: str  # below the sequence's, or THINNED; "" for the undrifted one
    before_m: float
    after_m: float
    objects_f: str  # "-" without a reference
    loops: dict

    @property
    def ratio(self):
        return self.before_m / self.after_m

    @property
    def level(self):
        return level_of(self.file) if self.folder else UNDRIFTED


def measure(context, sequence, path, folder):
    programs = context.programs
    run = programs.successful_run(replaced(sequence, path) if folder else sequence, GRAPH)
    before, after = (programs.trajectory(poses, sequence.ground_truth)["ate_m"]["rmse"]
                     for poses in (path, run.trajectory))
    objects_f = f"{programs.objects(run, sequence)['certain']['f']:.3f}" if sequence.reference else "-"
    loops = programs.loops(run, programs.successful_run(sequence, GRAPH))
    return Row(sequence.name, os.path.splitext(os.path.basename(path))[0], folder, before, after, objects_f, loops)


def measured(context):
    for sequence in context.sequences:
        if not sequence.frames:
            context.programs.note(f"The odometry table leaves out {sequence.name}: it has no groundtruth_frames.txt.")
            continue
        yield measure(context, sequence, sequence.trajectory, "")
        for folder, paths in zip(FOLDERS, (sequence.drifted, sequence.drifted_real)):
            for path in paths:
                yield measure(context, sequence, path, folder)
        for path in sequence.drifted_real:
            yield measure(context, sequence, thinned(context, replaced(sequence, path), FRAME_STEP).trajectory, THINNED)


def level_rows(rows):
    names = list(dict.fromkeys(row.sequence for row in rows))
    for folder in (*FOLDERS, THINNED):
        for level in LEVELS:
            for title, chosen in [(name, (name,)) for name in names] + [("all", names)]:
                some = [r for r in rows if (r.folder, r.level) == (folder, level) and r.sequence in chosen]
                if some:
                    yield [folder, level, title, len(some), f"{geometric_mean([r.ratio for r in some]):.1f} x",
                           f"{min(r.ratio for r in some):.1f} x", f"{statistics.median(r.after_m for r in some):.3f}",
                           share(pool(r.loops["right_wide"] for r in some)), share(pool(r.loops["closed"] for r in some))]


def kind_rows(rows):
    """Gain, and F of the objects, of each file by the kind of its drift, seeds in order."""
    for name in dict.fromkeys(row.sequence for row in rows):
        for level in LEVELS:
            some = [r for r in rows if (r.folder, r.level, r.sequence) == ("drifted_real", level, name)]
            by_kind = [[r for r in some if r.file.startswith(kind)] for kind in KINDS]
            if some:
                yield ["drifted_real", name, level, *(", ".join(f"{r.ratio:.1f}" for r in files) for files in by_kind),
                       f"{geometric_mean([r.ratio for r in some]):.1f} x"]
                yield ["objects F", name, level, *(", ".join(r.objects_f for r in files) for files in by_kind), ""]


def table_odometry(context):
    rows = list(measured(context))
    cells = [[r.sequence, r.file, f"{r.before_m:.4f}", f"{r.after_m:.4f}", f"{r.ratio:.1f} x", r.objects_f,
              share(r.loops["right_wide"]), share(r.loops["closed"])] for r in rows]
    return ("### Odometry\n\n**Every odometry file**\n\n" + markdown(COLUMNS, cells) + "\n**Drifted odometry by level**\n\n" +
            markdown(LEVEL_COLUMNS, level_rows(rows)) + "\n**Gain by kind of drift**\n\n" +
            markdown(KIND_COLUMNS, kind_rows(rows)) + "\n" + NOTES)
