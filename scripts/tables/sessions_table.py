"""Later sessions: a map of a sequence's first part, and runs that go on with it from odometry frames of their own."""

import os
import random
import statistics

from association_tables import markdown
from inputs import moved, poses_of
from runs import read_rows

FIRST_FRAMES = {"fr2_desk": 1400, "fr3_office": 1291}  # of the map
STARTS, STARTS_ELSEWHERE = 20, 4
LAST_FRAMES = 500  # that the last start has left
FOUND_COLUMNS = ("map", "later run", "starts", "found", "after, s", "ATE of both, m")
MERGED_COLUMNS = ("sequence", "confirmed objects of the parts", "of both", "ATE of all keyframes, m")

NOTES = """Starts are spread evenly from the end of the map's part on, each odometry in a frame of its own (a random SE(3),
seed: number of the start). Found: a loop into the map is accepted; after: recorded time until then. ATE of the keyframes
of both sessions, in one frame. Least, median, most.
"""


def write(context, name, lines):
    path = os.path.join(context.inputs, name + ".txt")
    with open(path, "w") as file:
        file.writelines(lines)
    return path


class Session:
    """A run on some poses of a sequence, its map, and how soon it found the map that it goes on with."""

    def __init__(self, context, sequence, name, lines, earlier=None):
        self._programs, self.sequence = context.programs, sequence
        folder = os.path.join(context.output, "sessions", name)
        self.map = folder + ".db"
        words = ["--map", earlier.map] if earlier else []
        self._programs.offline(sequence, write(context, name, lines), folder, *words, "--save-map", self.map)
        begin_s = float(lines[0].split()[0])
        # Frames are counted on from those of the map, whatever the clocks of the two recordings say.
        begin = int(read_rows(os.path.join(folder, "keyframes.csv"))[0]["frame_id"])
        self.found_s = [float(row["query_stamp"]) - begin_s for row in read_rows(os.path.join(folder, "loops.csv"))
                        if row["accepted"] == "1" and int(row["match_frame"]) < begin] if earlier else []

    def ate_m(self):
        return ate_m(self._programs, self.map, self.sequence)


def ate_m(programs, path, sequence):
    """Of all keyframes of a map."""
    programs.call("inspect_map", path, "--trajectory", path + ".txt")
    return programs.trajectory(path + ".txt", sequence.ground_truth)["ate_m"]["rmse"]


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
    found = [run for run in runs if run.found_s]
    return [first.sequence.name, sequence.name, starts, len(found), spread([min(run.found_s) for run in found], 1),
            spread([run.ate_m() for run in found], 4)]


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
    lines = {sequence.name: poses_of(sequence) for sequence in sequences}
    ends = {name: FIRST_FRAMES[name] for name in lines}
    firsts = [Session(context, s, s.name + "_first", lines[s.name][:ends[s.name]]) for s in sequences]
    found = [later_row(context, first, s, lines[s.name], STARTS, ends[s.name]) for first, s in zip(firsts, sequences)]
    found += [later_row(context, first, s, lines[s.name], STARTS_ELSEWHERE, 0) for first in firsts for s in sequences
              if s.name != first.sequence.name]
    merged = []
    for first, s in zip(firsts, sequences):
        rest = list(moved(lines[s.name][ends[s.name]:], random.Random(0)))
        merged.append(merged_row(context, first, Session(context, s, s.name + "_rest", rest)))
    return ("### Sessions\n\n**Later runs in a map**\n\n" + markdown(FOUND_COLUMNS, found) + "\n**Maps joined**\n\n" +
            markdown(MERGED_COLUMNS, merged) + "\n" + NOTES)
