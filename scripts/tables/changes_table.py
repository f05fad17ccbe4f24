"""Two simulated laps round a desk, the second one a session that goes on with the map of the first: between them a cup
is moved, a chair goes and a bottle comes. `inspect_map` shall list these three where they are, and nothing else. Once
from rendered images, whose odometry is found from them, and once from boxes alone, with an odometry that drifts and is in
another frame in the second lap. A row a desk: what is listed, and of what is not, whether it is an object of the map at
all; and how often exactly these are listed, which changes.json has too."""

import argparse
import json
import os
import random
import re
import shutil
import sys

import numpy as np

from association_tables import markdown
from inputs import lines_of, moved
from robots_table import pose
from runs import Failure, Programs, package_folder, read_rows

LAP_S, RATE_HZ = 36, 10
SIMULATION = (
    f"trajectory.duration_s={2 * LAP_S}",
    f"trajectory.rate_hz={RATE_HZ}",
    "dynamics.moved_objects=1",
    "dynamics.removed_objects=1",
    "dynamics.new_objects=1",
    f"dynamics.move_time_s={LAP_S}",
)
CHANGES = ("moved cup", "gone chair", "new bottle")
SAME_PLACE_M = 0.4  # between where the map and the truth have one object's middle; the next of its class may be as near
LISTED, NO_OBJECT = "listed", "no object"
INPUTS = {"rendered": "rendered images", "boxes": "boxes alone"}


class Change:
    """What changed, as "gone chair", and where it was before or, if it is new, is now: x, y, z in the world."""

    def __init__(self, kind, label, place):
        self.kind, self.label, self.place = kind, label, np.array(place, float)
        self.name = f"{kind} {label}"

    def is_at(self, place):
        return np.linalg.norm(self.place - place) < SAME_PLACE_M

    def is_same(self, other):
        return self.name == other.name and self.is_at(other.place)


class Desk:
    """The files of one seed."""

    def __init__(self, arguments, programs, source, seed):
        self._programs, self._seed = programs, seed
        self._scene, self._settings = (*SIMULATION, *arguments.scene), arguments.set
        self._is_rendered = source == "rendered"
        self._folder = os.path.join(arguments.output, "runs", f"{source}_{seed}")
        self._sequence = self.path("sequence")

    def path(self, *parts):
        return os.path.join(self._folder, *parts)

    def simulate(self):
        self._programs.call("simulate", "--output", self._sequence, "--camera",
                            os.path.join(package_folder(), "config/camera/tum_fr2.yaml"), "--seed", str(self._seed),
                            "--images", str(self._is_rendered).lower(),
                            *(word for setting in self._scene for word in ("--set", setting)))

    def remove_sequence(self):
        """Its images are large."""
        shutil.rmtree(self._sequence)

    def true_changes(self):
        """@return the changes, and how many boxes showed the chair"""
        changes, chair_boxes = [], 0
        for row in read_rows(os.path.join(self._sequence, "gone_objects.csv")):
            kind = "gone" if row["reference_id"] == "-1" else "moved"
            changes.append(Change(kind, row["label"], [row[key] for key in "xyz"]))
            if kind == "gone":
                chair_boxes = int(row["views"])
        for row in read_rows(os.path.join(self._sequence, "reference_objects.csv")):
            if row["label"] == "bottle" and int(row["first"]) >= LAP_S * RATE_HZ:
                changes.append(Change("new", row["label"], [row[key] for key in "xyz"]))
        if tuple(change.name for change in changes) != CHANGES:
            raise Failure(f"desk {self._seed}: not a cup, a chair and a bottle: {[change.name for change in changes]}")
        return changes, chair_boxes

    def map_laps(self):
        for lap in range(2):
            self._map_lap(lap)

    def listed_changes(self):
        said = self._programs.call("inspect_map", self.path("lap1.db"))
        found = re.findall(r"^ +(gone|moved|new): (.+?) \d+ \((\S+) (\S+) (\S+)\)", said, re.MULTILINE)
        return [Change(kind, label, self._in_world(place)) for kind, label, *place in found]

    def is_object(self, change):
        """Whether the map that should have had it has an object there: the first lap's, if it is not new."""
        database = self.path("lap1.db" if change.kind == "new" else "lap0.db")
        self._programs.call("inspect_map", database, "--objects", self.path("objects.csv"))
        return any(row["state"] == "confirmed" and row["label"] == change.label and
                   change.is_at(self._in_world([row[key] for key in "xyz"])) for row in read_rows(self.path("objects.csv")))

    def _in_world(self, place):
        """Of a map, which begins at the first camera."""
        first = lines_of(os.path.join(self._sequence, "groundtruth_frames.txt"))[0]
        T_world_map = pose([float(value) for value in first.split()[1:]])
        return (T_world_map @ [*map(float, place), 1.0])[:3]

    def _map_lap(self, lap):
        self._programs.call("offline", *self._images(lap) if self._is_rendered else self._odometry(lap), "--camera",
                            os.path.join(self._sequence, "camera.yaml"), "--detections",
                            os.path.join(self._sequence, "detections.json"), "--output", self.path(f"lap{lap}"),
                            *(["--map", self.path("lap0.db")] if lap else []), "--save-map", self.path(f"lap{lap}.db"),
                            *(word for setting in self._settings for word in ("--set", setting)))

    def _images(self, lap):
        return ["--rgbd", self._sequence, "--associations", self._write_lap("associations.txt", lap), "--set",
                "depth.scale=5000"]

    def _odometry(self, lap):
        return ["--trajectory", self._write_lap("odometry.txt", lap, is_moved=lap == 1)]

    def _write_lap(self, name, lap, is_moved=False):
        """The lines of a file that belong to one lap. @param is_moved their poses are put into another frame"""
        lines = lines_of(os.path.join(self._sequence, name))
        end_s = float(lines[0].split()[0]) + LAP_S - 0.5 / RATE_HZ
        lines = [line for line in lines if (float(line.split()[0]) > end_s) == bool(lap)]
        path = self.path(f"lap{lap}_{name}")
        with open(path, "w") as file:
            file.writelines(moved(lines, random.Random(self._seed)) if is_moved else lines)
        return path


def measure(arguments, programs, source, seed):
    print(f"changes_table: {INPUTS[source]}, desk {seed}", file=sys.stderr)
    desk = Desk(arguments, programs, source, seed)
    desk.simulate()
    desk.map_laps()
    changes, chair_boxes = desk.true_changes()
    listed = desk.listed_changes()
    row = {"desk": seed, "boxes of the chair": chair_boxes}
    for change in changes:
        mine = next((other for other in listed if other.is_same(change)), None)
        if mine:
            listed.remove(mine)
            row[change.name] = LISTED
        else:
            row[change.name] = "missing" if desk.is_object(change) else NO_OBJECT
    row["else"] = [change.name for change in listed]
    desk.remove_sequence()
    return row


def summary(rows):
    figures = {"seeds": len(rows), "nothing_else": sum(not row["else"] for row in rows),
               "exact": sum(all(row[name] == LISTED for name in CHANGES) and not row["else"] for row in rows)}
    for name in CHANGES:
        key = name.replace(" ", "_")
        figures[key] = sum(row[name] == LISTED for row in rows)
        figures[key + "_of"] = sum(row[name] != NO_OBJECT for row in rows)
    return figures


def desks_table(rows):
    return markdown(["desk", "boxes of the chair", *CHANGES, "else"],
                    [[row["desk"], row["boxes of the chair"], *(row[name] for name in CHANGES),
                      ", ".join(row["else"]) or "-"] for row in rows])


def summary_table(figures):
    def of_objects(counts, name):
        key = name.replace(" ", "_")
        return f"{counts[key]} of {counts[key + '_of']}"

    return markdown(["from", "desks", "exactly these listed", *CHANGES, "nothing else"],
                    [[INPUTS[source], counts["seeds"], counts["exact"], *(of_objects(counts, name) for name in CHANGES),
                      counts["nothing_else"]] for source, counts in figures.items()])


def parse_arguments():
    parser = argparse.ArgumentParser(prog="changes_table", description=__doc__)
    parser.add_argument("programs", help="folder of the programs")
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(2, 16)),
                        help="desks with rendered images, two minutes and a gigabyte each (default: 2 to 15)")
    parser.add_argument("--boxes-seeds", type=int, nargs="*", default=list(range(1, 31)),
                        help="desks with boxes alone (default: 1 to 30)")
    parser.add_argument("--output", default="/tmp/semantic_topo_loop_changes", metavar="DIR",
                        help="folder for inputs and results (default: %(default)s)")
    parser.add_argument("--scene", action="append", default=[], metavar="KEY=VALUE", help="a parameter of simulate")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of offline")
    return parser.parse_args()


def main():
    arguments = parse_arguments()
    try:
        programs = Programs(arguments.programs, arguments.output)
        seeds = {"rendered": arguments.seeds, "boxes": arguments.boxes_seeds}
        rows = {source: [measure(arguments, programs, source, seed) for seed in seeds[source]]
                for source in INPUTS if seeds[source]}
        figures = {source: summary(desks) for source, desks in rows.items()}
        text = "".join(f"**Desks, {INPUTS[source]}**\n\n{desks_table(desks)}\n" for source, desks in rows.items())
        text += "**Changes**\n\n" + summary_table(figures)
        print(text)
        with open(os.path.join(arguments.output, "tables.md"), "w") as file:
            file.write(text)
        with open(os.path.join(arguments.output, "changes.json"), "w") as file:
            json.dump(figures, file, indent=1)
    except Failure as failure:
        sys.exit(f"changes_table: error: {failure}")


if __name__ == "__main__":
    main()
