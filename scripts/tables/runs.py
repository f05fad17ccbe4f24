"""The recorded sequences, the methods, and one run of the programs `offline` and `evaluate` for a pair of them."""

import csv
import glob
import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass, field


class Failure(Exception):
    """Ends the script with one clear line."""


@dataclass(frozen=True)
class Sequence:
    name: str
    trajectory: str  # "" if the poses are found from the images
    detections: str
    camera: str
    ground_truth: str  # the motion capture's poses
    reference: str  # path, or "" without one
    frames: str = ""  # a true pose for every image, or ""
    drifted: tuple = ()  # paths of odometry with known drift
    drifted_real: tuple = ()  # that drifts as cameras and wheels do
    images: str = ""  # TUM folder

    def source(self, path):
        """Words for `offline`. @param path of an odometry, or of a TUM folder, of its own"""
        return ["--rgbd", path, "--set", "depth.scale=5000"] if self.images else ["--trajectory", path]


@dataclass(frozen=True)
class Method:
    key: str
    title: str
    settings: tuple = ()  # ("module.field=value", ...)


@dataclass
class Run:
    """What one method made of one sequence; `problem` is set, and nothing else, if the program refused it."""

    sequence: Sequence
    method: Method
    directory: str
    problem: str = ""
    summary: dict = field(default_factory=dict)
    objects: dict = field(default_factory=dict)  # figures of `evaluate objects`; empty without a reference
    times_real_time: float = 0.0

    @property
    def trajectory(self):
        """The optimised one."""
        return os.path.join(self.directory, "trajectory.txt")

    @property
    def details(self):
        """Folder of the files that `evaluate loops --details` writes."""
        return os.path.join(self.directory, "loops")


LEVELS = ("2d", "pro", "3d", "2d,pro", "2d,3d", "pro,3d", "2d,pro,3d")
FULL_LEVELS = LEVELS[-1]

# Nothing is merged, and every ellipsoid counts.
WITHOUT_MAPPING_RULES = (
    "mapping.merge_duplicates=false",
    "mapping.confirm_seen_s=0",
    "mapping.confirm_baseline_deg=0",
    "mapping.confirm_mean_iou=0",
    "mapping.confirm_seen_share=0",
    "mapping.confirm_quality=0",
)


def cascade(levels):
    title = "cascade, " + levels.replace("2d", "2D").replace("pro", "Pro").replace("3d", "3D").replace(",", " + ")
    key = "cascade" if levels == FULL_LEVELS else "cascade_" + levels.replace(",", "_")
    return Method(key, title, ("association.mode=cascade", "association.levels=" + levels))


def bare(method):
    """The same without what merging and confirmation add."""
    return Method(method.key + "_bare", method.title, method.settings + WITHOUT_MAPPING_RULES)


JDA = Method("jda", "JDA", ("association.mode=jda",))
JOINT = Method("joint", "joint assignment (default)")
GRAPH = Method("joint", "graph (default)")  # the same run as JOINT's, in the tables of loops
PAPER_CORRECTED = Method("loops_paper", "paper, corrected score", ("loop.mode=paper",))
PAPER_PRINTED = Method("loops_printed", "paper, printed score", ("loop.mode=paper", "loop.score=printed"))


def truth_of(folder):
    """What a sequence's folder holds for the tables of loops and trajectories."""
    frames = os.path.join(folder, "groundtruth_frames.txt")
    drifted, drifted_real = (tuple(sorted(glob.glob(os.path.join(folder, name, "*.txt"))))
                             for name in ("drifted", "drifted_real"))
    return frames if os.path.exists(frames) else "", drifted, drifted_real


def find_sequences(data, fr3_reference):
    """The sequences whose files are there, in a fixed order."""
    fr2, fr3 = os.path.join(data, "tum/fr2_desk"), os.path.join(data, "tum/fr3_office")
    fr2_reference = os.path.join(fr2, "reference_objects.csv")
    candidates = [
        Sequence("fr2_desk", fr2 + "/orbslam2_rgbd_trajectory.txt", fr2 + "/detections_yolov5.json", "tum_fr2.yaml",
                 fr2 + "/groundtruth.txt", fr2_reference if os.path.exists(fr2_reference) else "", *truth_of(fr2)),
        Sequence("fr3_office", fr3 + "/groundtruth_frames.txt", fr3 + "/detections_yolov3", "tum_fr3.yaml",
                 fr3 + "/groundtruth.txt", fr3_reference, *truth_of(fr3)),
    ]
    found = [s for s in candidates if all(map(os.path.exists, (s.trajectory, s.detections, s.ground_truth)))]
    if not found:
        raise Failure(f"'{data}' holds neither tum/fr2_desk nor tum/fr3_office (--data, SEMANTIC_TOPO_LOOP_DATA)")
    return found


def find_image_sequences(data):
    """Those whose poses and depth come from images."""
    folder = os.path.join(data, "tum/fr1_xyz")
    sequence = Sequence("fr1_xyz", "", folder + "/detections_yolox_nano.json", "tum_fr1.yaml", folder + "/groundtruth.txt",
                        folder + "/reference_objects.csv", images=folder)
    files = (sequence.detections, sequence.ground_truth, sequence.reference, folder + "/rgb.txt")
    return [sequence] if all(map(os.path.exists, files)) else []


def read_rows(path):
    """A CSV file with a header, a dictionary a row; as the programs read it, blank lines and comments are none."""
    with open(path, newline="", encoding="utf-8-sig") as file:
        return list(csv.DictReader(line for line in file if line.strip() and not line.startswith("#")))


def package_folder():
    """Where config/ is: the checkout, or what is installed of it in share/."""
    above = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    installed = os.path.join(os.path.dirname(above), "share/semantic_topo_loop")
    return above if os.path.exists(os.path.join(above, "package.xml")) else installed


def default_data():
    return os.environ.get("SEMANTIC_TOPO_LOOP_DATA") or os.path.join(os.path.dirname(package_folder()), "shared")


class Programs:
    """Calls the package's programs and keeps the results, so that two tables share a run."""

    def __init__(self, programs, output):
        self._programs = programs
        self._cameras = os.path.join(package_folder(), "config/camera")
        self._classes = os.path.join(package_folder(), "config/classes_coco.yaml")
        self._output = output
        os.makedirs(os.path.join(output, "runs"), exist_ok=True)
        self._runs = {}
        self._loops = {}
        for name in ("offline", "evaluate", "perturb"):
            if not os.access(os.path.join(programs, name), os.X_OK):
                raise Failure(f"'{programs}' has no program {name} (--programs)")
        self.notes = []

    def run(self, sequence, method):
        if (sequence.name, method.key) not in self._runs:
            print(f"paper_tables: {sequence.name}, {method.key}", file=sys.stderr)
            self._runs[sequence.name, method.key] = self._run(sequence, method)
        return self._runs[sequence.name, method.key]

    def successful_run(self, sequence, method):
        """For tables that have no row for a run that failed."""
        run = self.run(sequence, method)
        if run.problem:
            raise Failure(f"{method.title} on {sequence.name}: {run.problem}")
        return run

    def perturb_detections(self, source, target, *arguments):
        self.call("perturb", "detections", source, target, *arguments)

    def call(self, name, *arguments):
        """Of a program that takes classes. @return what it printed"""
        result = self._call(name, *arguments, "--classes", self._classes)
        if result.returncode != 0:
            raise Failure(f"{name}: {result.stderr.strip()}")
        return result.stdout

    def offline(self, sequence, path, output, *arguments):
        """A run that no table shares, on an odometry or images of one's own."""
        self.call("offline", *sequence.source(path), "--detections", sequence.detections, "--camera",
                  os.path.join(self._cameras, sequence.camera), "--output", output, *arguments)

    def _call(self, name, *arguments):
        command = [os.path.join(self._programs, name), *arguments]
        return subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True)

    def note(self, text):
        if text not in self.notes:
            self.notes.append(text)

    def _run(self, sequence, method):
        run = Run(sequence, method, os.path.join(self._output, "runs", sequence.name, method.key))
        os.makedirs(run.directory, exist_ok=True)
        source = sequence.source(sequence.images or sequence.trajectory)
        result = self._call("offline", *source, "--detections", sequence.detections, "--camera",
                            os.path.join(self._cameras, sequence.camera), "--classes", self._classes, "--output",
                            run.directory, *(word for setting in method.settings for word in ("--set", setting)))
        if result.returncode != 0:
            errors = [line for line in result.stderr.splitlines() if "error" in line] or ["no message"]
            run.problem = errors[0].replace("offline: error: ", "")
            self.note(f"{method.title} is not available on {sequence.name}: {run.problem}.")
            return run
        speed = re.search(r"([0-9.]+) x real time", result.stdout)
        run.times_real_time = float(speed.group(1)) if speed else 0.0
        with open(os.path.join(run.directory, "summary.json")) as file:
            run.summary = json.load(file)
        if sequence.reference:
            run.objects = self.objects(run, sequence)
        return run

    def objects(self, run, sequence):
        """Figures of the run's objects against the reference of a sequence."""
        return self._evaluate("objects", run.directory, sequence.ground_truth, sequence.reference,
                              json_path=os.path.join(run.directory, "evaluation_objects.json"))

    def loops(self, run, sightings):
        """Figures of the run's loops; single loops, pairs and curves come into run.details.
        @param sightings the run that tells which objects two keyframes have in common"""
        if run.directory not in self._loops:
            self._loops[run.directory] = self._evaluate(
                "loops", run.directory, run.sequence.frames, "--mocap", run.sequence.ground_truth, "--sightings",
                sightings.directory, "--details", run.details,
                json_path=os.path.join(run.directory, "evaluation_loops.json"))
        return self._loops[run.directory]

    def trajectory(self, path, ground_truth, *arguments):
        """Errors of a trajectory file."""
        return self._evaluate("trajectory", path, ground_truth, *arguments,
                              json_path=os.path.join(self._output, "runs", "evaluation_trajectory.json"))

    def _evaluate(self, *arguments, json_path):
        result = self._call("evaluate", *arguments, "--json", json_path)
        if result.returncode != 0:
            raise Failure(result.stderr.strip())
        with open(json_path) as file:
            return json.load(file)
