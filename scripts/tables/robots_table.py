"""Three robots in a house of 12 rooms in a row: the first maps rooms 1 to 6, the second 4 to 9, the third 7 to 12, each
by itself, with an odometry frame, drift and a detector's errors of its own. `merge_maps` joins the first two maps and
then the third, and shall refuse the first and the third, which share no room. A row a house: what each robot's
trajectory and objects are like alone and in the joined map, the loops between robots, and what was joined wrongly."""

import argparse
import collections
import csv
import json
import math
import os
import sqlite3
import statistics
import subprocess
import sys
import time

import numpy as np

from association_tables import markdown
from inputs import lines_of
from runs import Failure, package_folder, read_rows

ROOMS, ROOMS_OF_ROBOT, FIRST_ROOMS = 12, 6, (1, 4, 7)
SIMULATION = (
    f"scene.desks={ROOMS}",
    "scene.layout=house",
    "trajectory.model=robot",
    f"trajectory.desks={ROOMS_OF_ROBOT}",
    "trajectory.lap_s=160",
    "trajectory.duration_s=320",
    "trajectory.rate_hz=10",
    "drift.position_m=3",
    "drift.rotation_deg=10",
    "simulation.odometry_frame=random",
)
RIGHT_M, RIGHT_DEG = 0.35, 10.0  # of a loop: within these of the true pose
CLOCK_S = 10000  # between the stamps of two robots, where poses of all of them are in one file


def rotation(q):
    """Matrix of a quaternion x, y, z, w."""
    x, y, z, w = q / np.linalg.norm(q)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def pose(values):
    """4x4 matrix of x, y, z, qx, qy, qz, qw."""
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = values[:3], rotation(np.array(values[3:7]))
    return T


def product(a, b):
    """Of two poses x, y, z, qx, qy, qz, qw."""
    (u, s), (v, t) = ((np.array(q[3:6]), q[6]) for q in (a, b))
    return (*map(float, (*pose(a)[:3, 3] + pose(a)[:3, :3] @ b[:3], *s * v + t * u + np.cross(u, v), s * t - u @ v)),)


class Map:
    """What a map's file holds, by session: those of a joined map are the robots', in the order they were joined."""

    def __init__(self, path):
        with sqlite3.connect(path) as database:
            firsts = [row[0] for row in database.execute("SELECT first_keyframe FROM session ORDER BY first_keyframe")]
            self._firsts = firsts
            self.keyframes = {}  # by id: frame, stamp in ns, pose in the map
            for keyframe, frame, stamp_ns, is_vertex, *values in database.execute(
                    "SELECT id, frame, stamp_ns, is_vertex, x, y, z, qx, qy, qz, qw FROM keyframe ORDER BY id"):
                vertex = tuple(values) if is_vertex else vertex
                self.keyframes[keyframe] = (frame, stamp_ns, vertex if is_vertex else product(vertex, values))
            self._first_frames = [self.keyframes[first][0] for first in firsts]
            camera = json.loads(database.execute("SELECT value FROM meta WHERE key = 'camera'").fetchone()[0])
            self.focal = np.array([camera["fx"], camera["fy"]])
            self.middle = np.array([camera["cx"], camera["cy"]])
            self.boxes = database.execute(
                "SELECT object, frame, keyframe, observation.class, x1, y1, x2, y2 FROM observation JOIN object "
                "ON object.id = object "
                "WHERE state = 'confirmed' ORDER BY object, number").fetchall()

    def session(self, keyframe):
        return sum(first <= keyframe for first in self._firsts) - 1

    def frame_of_robot(self, frame, session):
        """Its number in the robot's own run."""
        return frame - self._first_frames[session]

    def write_trajectory(self, path, robots, only=None):
        """TUM format, of all sessions or one; `robots` names whose session each is."""
        with open(path, "w") as file:
            for keyframe, (_, stamp_ns, values) in self.keyframes.items():
                session = self.session(keyframe)
                if only is not None and session != only:
                    continue
                stamp_ns += robots[session] * CLOCK_S * 10**9
                file.write(f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} " + " ".join(map(repr, values)) + "\n")


class House:
    """The files of one seed."""

    def __init__(self, arguments, seed):
        self._arguments = arguments
        self.seed = seed
        self._folder = os.path.join(arguments.output, f"house_{seed}")
        self._classes = os.path.join(package_folder(), "config/classes_coco.yaml")
        self.truth = []  # T_world_camera of each robot's frames

    def path(self, *parts):
        return os.path.join(self._folder, *parts)

    def program(self, name, *words):
        """@return exit code and what it said"""
        done = subprocess.run([os.path.join(self._arguments.programs, name), *words], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, universal_newlines=True)
        return done.returncode, done.stdout.strip()

    def succeed(self, name, *words):
        code, said = self.program(name, *words)
        if code != 0:
            raise Failure(f"house {self.seed}: {said}")
        return said

    def settings(self):
        return [word for setting in self._arguments.set for word in ("--set", setting)]

    def map_alone(self, robot):
        folder, result = self.path(f"robot{robot}"), self.path(f"robot{robot}.db")
        if self._arguments.keep_maps and os.path.exists(result):
            return
        options = (*SIMULATION, f"scene.seed={self.seed}", f"simulation.seed={100 * self.seed + robot}",
                   f"trajectory.first_desk={FIRST_ROOMS[robot]}", *self._arguments.scene)
        self.succeed("simulate", "--output", folder, "--classes", self._classes, "--camera",
                     os.path.join(package_folder(), "config/camera/tum_fr2.yaml"),
                     *[word for option in options for word in ("--set", option)])
        self.succeed("offline", "--trajectory", os.path.join(folder, "odometry.txt"), "--detections",
                     os.path.join(folder, "detections.json"), "--camera", os.path.join(folder, "camera.yaml"),
                     "--classes", self._classes, "--output", os.path.join(folder, "alone"), "--save-map", result,
                     *self.settings())

    def read_truth(self):
        """Also writes it with the stamps of write_trajectory; and the objects that any robot saw."""
        references = {}
        with open(self.path("truth.txt"), "w") as file:
            for robot in range(len(FIRST_ROOMS)):
                rows = [line.split() for line in lines_of(self.path(f"robot{robot}", "groundtruth_frames.txt"))]
                self.truth.append(np.array([pose([float(v) for v in row[1:]]) for row in rows]))
                for row in rows:
                    second, fraction = row[0].split(".")
                    file.write(f"{int(second) + robot * CLOCK_S}.{fraction} " + " ".join(row[1:]) + "\n")
                for row in read_rows(self.path(f"robot{robot}", "reference_objects.csv")):
                    references[tuple(row[key] for key in ("label", "x", "y", "z"))] = row
        self.objects = np.array([[float(row[key]) for key in "xyz"] for row in references.values()])
        self.labels = np.array([int(row["label_id"]) for row in references.values()])
        self.radii = np.array([max(float(row[key]) for key in "abc") for row in references.values()])

    def merge(self, a, b, result):
        """@return whether they were joined, the seconds that it took"""
        path = self.path(result)
        if os.path.exists(path):
            os.remove(path)
        begin = time.monotonic()
        code, said = self.program("merge_maps", self.path(a), self.path(b), path, "--classes", self._classes,
                                  *self.settings())
        if code != 0 and "nothing is written" not in said:
            raise Failure(f"house {self.seed}: {said}")
        return os.path.exists(path), time.monotonic() - begin

    def ate_m(self, trajectory):
        self.succeed("evaluate", "trajectory", trajectory, self.path("truth.txt"), "--json", self.path("ate.json"))
        with open(self.path("ate.json")) as file:
            return json.load(file)["ate_m"]["rmse"]

    def judge_trajectory(self, name, robots):
        """ATE of each session by itself, and of all in one alignment."""
        built = Map(self.path(name))
        alone = []
        for session in range(len(robots)):
            built.write_trajectory(self.path("session.txt"), robots, session)
            alone.append(self.ate_m(self.path("session.txt")))
        built.write_trajectory(self.path("session.txt"), robots)
        return alone, self.ate_m(self.path("session.txt"))

    def judge_loops(self, name):
        """Kept loops between sessions, by pair of them, and how many of them are wrong."""
        built = Map(self.path(name))
        graph = self.path("graph.g2o")
        self.succeed("inspect_map", self.path(name), "--graph", graph, "--classes", self._classes)
        loops, wrong = collections.Counter(), 0
        with open(graph) as file:
            edges = [line.split() for line in file if line.startswith("EDGE_SE3")]
        odometry = set()  # the first edge of each vertex leads to the next one
        for edge in edges:
            begin, end = int(edge[1]), int(edge[2])
            sessions = built.session(begin), built.session(end)
            if begin not in odometry or sessions[0] == sessions[1]:
                odometry.add(begin)
                continue
            T = [self.truth[session][built.frame_of_robot(built.keyframes[vertex][0], session)]
                 for vertex, session in zip((begin, end), sessions)]
            error = np.linalg.inv(np.linalg.inv(T[0]) @ T[1]) @ pose([float(value) for value in edge[3:10]])
            angle_deg = math.degrees(math.acos(max(-1.0, min(1.0, (np.trace(error[:3, :3]) - 1) / 2))))
            loops[sessions] += 1
            wrong += np.linalg.norm(error[:3, 3]) > RIGHT_M or angle_deg > RIGHT_DEG
        return loops, wrong

    def seen(self, built, session, boxes):
        """The true object of the boxes' classes that most of them show, with more than half; none without one."""
        votes = collections.Counter()
        for _, frame, _, label, *box in boxes:
            T_camera_world = np.linalg.inv(self.truth[session][built.frame_of_robot(frame, session)])
            points = self.objects @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
            # No farther than a room's other end.
            near = np.flatnonzero((points[:, 2] > 0.1) & (points[:, 2] < 6.0) & (self.labels == label))
            pixels = points[near, :2] / points[near, 2:] * built.focal + built.middle
            size = np.array([box[2] - box[0], box[3] - box[1]])
            off = np.linalg.norm((pixels - np.add(box[:2], box[2:]) / 2) / size, axis=1)
            off += np.abs(np.log(2 * built.focal[0] * self.radii[near] / points[near, 2] / size.max()))
            if len(near):
                votes[near[np.argmin(off)]] += 1
        best = votes.most_common(1)
        return best[0][0] if best and 2 * best[0][1] > len(boxes) else None

    def boxes_by_object(self, built):
        """Of the confirmed objects, by session."""
        boxes = collections.defaultdict(lambda: collections.defaultdict(list))
        for row in built.boxes:
            boxes[row[0]][built.session(row[2])].append(row)
        return boxes

    def judge_objects(self, name, session, robot):
        """F of those that a session has boxes of, by its robot's reference, moved by the session's own alignment."""
        built = Map(self.path(name))
        own = {object_id for object_id, sessions in self.boxes_by_object(built).items() if session in sessions}
        run = self.path("run")
        os.makedirs(run, exist_ok=True)
        built.write_trajectory(os.path.join(run, "trajectory.txt"), {session: robot}, session)
        self.succeed("inspect_map", self.path(name), "--objects", self.path("objects.csv"), "--classes", self._classes)
        rows = read_rows(self.path("objects.csv"))
        with open(os.path.join(run, "objects.csv"), "w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(row for row in rows if int(row["id"]) in own)
        self.succeed("evaluate", "objects", run, self.path("truth.txt"),
                     self.path(f"robot{robot}", "reference_objects.csv"), "--json", self.path("objects.json"))
        with open(self.path("objects.json")) as file:
            return json.load(file)["certain"]["f"]

    def judge_joins(self, name):
        """How many confirmed objects have boxes of several robots, of how many of these the robots' boxes show
        different things, and how many true objects are shown by several."""
        built = Map(self.path(name))
        shared = wrong = 0
        shown_by = collections.Counter()
        for sessions in self.boxes_by_object(built).values():
            shown = {self.seen(built, session, rows[::1 + len(rows) // 50]) for session, rows in sessions.items()}
            shown.discard(None)
            shown_by.update(shown)
            shared += len(sessions) > 1
            wrong += len(shown) > 1
        return shared, wrong, sum(count > 1 for count in shown_by.values())


def measure(arguments, seed):
    print(f"robots_table: house {seed}", file=sys.stderr)
    house = House(arguments, seed)
    robots = range(len(FIRST_ROOMS))
    for robot in robots:
        house.map_alone(robot)
    house.read_truth()
    alone = [house.judge_trajectory(f"robot{robot}.db", [robot])[1] for robot in robots]
    is_apart = not house.merge("robot0.db", "robot2.db", "apart.db")[0]
    is_joined, seconds = house.merge("robot0.db", "robot1.db", "two.db")
    if is_joined:
        is_joined, more = house.merge("two.db", "robot2.db", "all.db")
        seconds += more
    f_alone = [house.judge_objects(f"robot{robot}.db", 0, robot) for robot in robots]
    row = {"house": seed, "alone": alone, "f_alone": f_alone, "1 + 3": "refused" if is_apart else "JOINED", "seconds": seconds}
    if not is_joined:
        return row
    parts, whole = house.judge_trajectory("all.db", robots)
    first, _ = house.judge_loops("two.db")
    last, wrong_last = house.judge_loops("all.db")
    row.update(parts=parts, whole=whole, ratio=max(part / own for part, own in zip(parts, alone)),
               loops=(first[0, 1], last[1, 2]), wrong=wrong_last, joins=house.judge_joins("all.db"),
               f=[house.judge_objects("all.db", robot, robot) for robot in robots])
    return row


def table(rows):
    def metres(values):
        return " / ".join(f"{value:.3f}" for value in values)

    lines = []
    for row in rows:
        lines.append([row["house"], metres(row["alone"])])
        if "parts" in row:
            lines[-1] += [metres(row["parts"]), f"{row['ratio']:.2f}", f"{row['whole']:.3f}",
                          " / ".join(map(str, row["loops"])), row["wrong"], *row["joins"],
                          f"{statistics.mean(row['f_alone']):.3f} -> {statistics.mean(row['f']):.3f}"]
        else:
            lines[-1] += ["not joined"] + ["-"] * 8
        lines[-1] += [row["1 + 3"], f"{row['seconds']:.1f}"]
    return markdown(["house", "ATE alone, m", "ATE joined, m", "largest ratio", "ATE, one alignment, m",
                     "loops 1-2 / 2-3", "wrong", "objects of several robots", "wrong", "twice there",
                     "F of the objects", "1 + 3", "s"], lines)


def parse_arguments():
    parser = argparse.ArgumentParser(prog="robots_table", description=__doc__)
    parser.add_argument("programs", help="folder of the programs")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1, 11)), help="houses (default: 1 to 10)")
    parser.add_argument("--output", default="/tmp/semantic_topo_loop_robots", metavar="DIR",
                        help="folder for inputs and results (default: %(default)s)")
    parser.add_argument("--keep-maps", action="store_true", help="take the robots' maps that are there")
    parser.add_argument("--scene", action="append", default=[], metavar="KEY=VALUE", help="a parameter of simulate")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE",
                        help="a parameter of offline and merge_maps")
    return parser.parse_args()


def main():
    arguments = parse_arguments()
    try:
        text = "**Houses**\n\n" + table([measure(arguments, seed) for seed in arguments.seeds])
        print(text)
        with open(os.path.join(arguments.output, "tables.md"), "w") as file:
            file.write(text)
    except Failure as failure:
        sys.exit(f"robots_table: error: {failure}")


if __name__ == "__main__":
    main()
