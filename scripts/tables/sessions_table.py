"""Later sessions: a map of a sequence's first part, and runs that go on with it from odometry frames of their own."""

import os
import random
import statistics

from association_tables import markdown
from inputs import lines_of, moved
from runs import read_rows
from trajectory_table import geometric_mean

FIRST_FRAMES = {"fr2_desk": 1400, "fr3_office": 1291}  # of the map
STARTS, STARTS_ELSEWHERE = 20, 4
LAST_FRAMES = 500  # that the last start has left
IMAGE_STARTS, IMAGES_S = 5, 10  # of images that long
FOUND_COLUMNS = ("map", "later run", "starts", "found", "after, s", "off by, m", "off by, deg", "ATE of both, m")
POORER_LEVEL = "_1m_"  # of the drifting odometry
POORER_COLUMNS = ("map", "odometries", "ATE before, m", "alone, m", "in the map, m", "most, alone, m", "most, in the map, m")
MERGED_COLUMNS = ("sequence", "confirmed objects of the parts", "of both", "ATE of all keyframes, m")

NOTES = """Starts are spread evenly from the end of the map's part on, each odometry in a frame of its own (a random SE(3),
seed: number of the start). Found: a loop into the map is accepted; after: recorded time until then. ATE of the keyframes
of both sessions, in one frame. Least, median, most. Off by: the median over the session's keyframes, where the truth is
aligned by those of the map. Runs from images find their odometry themselves. Poorer odometry: of the whole sequence,
drifted as cameras and wheels do, in the map of its own odometry; geometric means over the files.
"""


def write(context, sequence, name, lines):
    """A part of a sequence: of its odometry, or the folder of its images."""
    path = os.path.join(context.inputs, name)
    if not sequence.images:
        return written(path + ".txt", lines)
    os.makedirs(path, exist_ok=True)
    for entry in ("rgb", "depth", "depth.txt"):
        link = os.path.join(path, entry)
        if not os.path.exists(link):
            os.symlink(os.path.abspath(os.path.join(sequence.images, entry)), link)
    written(os.path.join(path, "rgb.txt"), lines)
    return path


def written(path, lines):
    with open(path, "w") as file:
        file.writelines(lines)
    return path


def stamp(line):
    return float(line.split()[0])


class Session:
    """A run on some poses of a sequence, its map, and how soon it found the map that it goes on with."""

    def __init__(self, context, sequence, name, lines, earlier=None):
        self._programs, self.sequence = context.programs, sequence
        folder = os.path.join(context.output, "sessions", name)
        self.map = folder + ".db"
        words = ["--map", earlier.map] if earlier else []
        self._programs.offline(sequence, write(context, sequence, name, lines), folder, *words, "--save-map", self.map)
        self._begin_s = begin_s = stamp(lines[0])
        # Frames are counted on from those of the map, whatever the clocks of the two recordings say.
        begin = int(read_rows(os.path.join(folder, "keyframes.csv"))[0]["frame_id"])
        self.found_s = [float(row["query_stamp"]) - begin_s for row in read_rows(os.path.join(folder, "loops.csv"))
                        if row["accepted"] == "1" and int(row["match_frame"]) < begin] if earlier else []

    def ate_m(self):
        return ate_m(self._programs, self.map, self.sequence)

    def off_by(self):
        """@return m and deg by which the session's keyframes are off, in the frame of the map that it goes on with"""
        lines = lines_of(keyframes_of(self._programs, self.map))
        earlier = written(self.map + ".earlier.txt", [line for line in lines if stamp(line) < self._begin_s])
        own = written(self.map + ".own.txt", [line for line in lines if stamp(line) >= self._begin_s])
        errors = self._programs.trajectory(own, self.sequence.ground_truth, "--aligned-by", earlier)
        return errors["ate_m"]["median"], errors["ate_deg"]["median"]


def keyframes_of(programs, path):
    """Writes those of a map. @return path of the trajectory"""
    programs.call("inspect_map", path, "--trajectory", path + ".txt")
    return path + ".txt"


def ate_m(programs, path, sequence):
    """Of all keyframes of a map."""
    return programs.trajectory(keyframes_of(programs, path), sequence.ground_truth)["ate_m"]["rmse"]


def spread(values, digits):
    """Least, median, most."""
    if not values:
        return "-"
    return ", ".join(f"{value:.{digits}f}" for value in (min(values), statistics.median(values), max(values)))


def later_row(context, first, sequence, lines, starts, begin):
    """Runs on `lines` from `starts` places on, all in the map of `first`."""
    step = (len(lines) - LAST_FRAMES - begin) // starts
    runs = []
    for seed in range(1, starts + 1):
        part = lines[begin + (seed - 1) * step:]
        name = f"{sequence.name}_in_{first.sequence.name}_{seed}"
        runs.append(Session(context, sequence, name, list(moved(part, random.Random(seed))), first))
    return found_row(first, sequence, runs)


def found_row(first, sequence, runs):
    """How soon and how well runs on a sequence found their places in a map."""
    found = [run for run in runs if run.found_s]
    same = found if first.sequence.name == sequence.name else []
    off = [run.off_by() for run in same]
    return [first.sequence.name, sequence.name, len(runs), len(found), spread([min(run.found_s) for run in found], 1),
            spread([m for m, _ in off], 3), spread([deg for _, deg in off], 1), spread([run.ate_m() for run in same], 4)]


def image_row(context, first, sequence, lines, begin):
    """Runs on images from some places after `begin` on, in the map of `first`."""
    last = max(k for k, line in enumerate(lines) if stamp(lines[-1]) - stamp(line) >= IMAGES_S)
    runs = []
    for k in range(IMAGE_STARTS):
        rest = lines[begin + k * (last - begin) // (IMAGE_STARTS - 1):]
        part = [line for line in rest if stamp(line) < stamp(rest[0]) + IMAGES_S]
        runs.append(Session(context, sequence, f"{sequence.name}_in_{first.sequence.name}_{k + 1}", part, first))
    return found_row(first, sequence, runs)


def rows_from_images(context, elsewhere):
    """Each sequence's second half in the map of its first, and in other maps."""
    rows = []
    for sequence in context.image_sequences:
        lines = lines_of(os.path.join(sequence.images, "rgb.txt"))
        begin = len(lines) // 2
        first = Session(context, sequence, sequence.name + "_first", lines[:begin])
        rows += [image_row(context, earlier, sequence, lines, begin) for earlier in (first, *elsewhere)]
    return rows


def poorer(sequence):
    """Its files of odometry that drifts."""
    return [path for path in sequence.drifted_real if POORER_LEVEL in path]


def poorer_row(context, sequence):
    """Odometry that drifts, alone and in the map of one that hardly does."""
    programs = context.programs
    first = Session(context, sequence, sequence.name + "_whole", lines_of(sequence.trajectory))
    columns = [[], [], []]
    for path in poorer(sequence):
        folder = os.path.join(context.output, "sessions", sequence.name + "_" + os.path.basename(path)[:-4])
        result = os.path.join(folder, "trajectory.txt")
        columns[0].append(programs.trajectory(path, sequence.ground_truth)["ate_m"]["rmse"])
        for column, words in zip(columns[1:], ([], ["--map", first.map])):
            programs.offline(sequence, path, folder, *words)
            column.append(programs.trajectory(result, sequence.ground_truth)["ate_m"]["rmse"])
    means = [f"{geometric_mean(column):.3f}" for column in columns]
    return [sequence.name, len(columns[0]), *means, *(f"{max(column):.3f}" for column in columns[1:])]


def confirmed(programs, path):
    programs.call("inspect_map", path, "--objects", path + ".csv")
    return sum(row["state"] == "confirmed" for row in read_rows(path + ".csv"))


def merged_row(context, first, second):
    """Two maps of one sequence as `merge_maps` joins them."""
    programs, result = context.programs, first.map[:-3] + "_merged.db"
    if os.path.exists(result):
        os.remove(result)
    programs.call("merge_maps", first.map, second.map, result)
    counts = [confirmed(programs, path) for path in (first.map, second.map, result)]
    return [first.sequence.name, f"{counts[0]}, {counts[1]}", counts[2], f"{ate_m(programs, result, first.sequence):.4f}"]


def table_sessions(context):
    sequences = [sequence for sequence in context.sequences if sequence.name in FIRST_FRAMES]
    lines = {sequence.name: lines_of(sequence.trajectory) for sequence in sequences}
    ends = {name: FIRST_FRAMES[name] for name in lines}
    firsts = [Session(context, s, s.name + "_first", lines[s.name][:ends[s.name]]) for s in sequences]
    found = [later_row(context, first, s, lines[s.name], STARTS, ends[s.name]) for first, s in zip(firsts, sequences)]
    found += [later_row(context, first, s, lines[s.name], STARTS_ELSEWHERE, 0) for first in firsts for s in sequences
              if s.name != first.sequence.name]
    merged = []
    for first, s in zip(firsts, sequences):
        rest = list(moved(lines[s.name][ends[s.name]:], random.Random(0)))
        merged.append(merged_row(context, first, Session(context, s, s.name + "_rest", rest)))
    return ("### Sessions\n\n**Later runs in a map**\n\n" + markdown(FOUND_COLUMNS, found) + "\n**Later runs from images**\n\n" +
            markdown(FOUND_COLUMNS, rows_from_images(context, firsts)) + "\n**Poorer odometry**\n\n" +
            markdown(POORER_COLUMNS, [poorer_row(context, s) for s in sequences if poorer(s)]) + "\n**Maps joined**\n\n" +
            markdown(MERGED_COLUMNS, merged) + "\n" + NOTES)
