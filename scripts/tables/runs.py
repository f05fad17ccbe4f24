"""The recorded sequences, the methods, and one run of the programs `offline` and `evaluate` for a pair of them."""

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
    trajectory: str
    detections: str
    camera: str
    ground_truth: str
    reference: str  # path, or "" without one


@dataclass(frozen=True)
class Method:
    key: str
    title: str
    settings: tuple  # ("module.field=value", ...)


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
JOINT = Method("joint", "joint assignment (default)", ())


def find_sequences(data, fr3_reference):
    """The sequences whose files are there, in a fixed order."""
    fr2, fr3 = os.path.join(data, "tum/fr2_desk"), os.path.join(data, "tum/fr3_office")
    fr2_reference = os.path.join(fr2, "reference_objects.csv")
    candidates = [
        Sequence("fr2_desk", fr2 + "/orbslam2_rgbd_trajectory.txt", fr2 + "/detections_yolov5.json", "tum_fr2.yaml",
                 fr2 + "/groundtruth.txt", fr2_reference if os.path.exists(fr2_reference) else ""),
        Sequence("fr3_office", fr3 + "/groundtruth_frames.txt", fr3 + "/detections_yolov3", "tum_fr3.yaml",
                 fr3 + "/groundtruth.txt", fr3_reference),
    ]
    found = [s for s in candidates if all(map(os.path.exists, (s.trajectory, s.detections, s.ground_truth)))]
    if not found:
        raise Failure(f"'{data}' holds neither tum/fr2_desk nor tum/fr3_office (--data, SEMANTIC_TOPO_LOOP_DATA)")
    return found


class Programs:
    """Calls the package's programs and keeps the results, so that two tables share a run."""

    def __init__(self, programs, package, output):
        self._programs = programs
        self._cameras = os.path.join(package, "config/camera")
        self._classes = os.path.join(package, "config/classes_coco.yaml")
        self._output = output
        self._runs = {}
        for name in ("offline", "evaluate", "perturb"):
            if not os.access(os.path.join(programs, name), os.X_OK):
                raise Failure(f"'{programs}' has no program {name} (--programs)")
        self._parameters = self._list_parameters()
        self.notes = []

    def run(self, sequence, method):
        if (sequence.name, method.key) not in self._runs:
            print(f"paper_tables: {sequence.name}, {method.key}", file=sys.stderr)
            self._runs[sequence.name, method.key] = self._run(sequence, method)
        return self._runs[sequence.name, method.key]

    def perturb_detections(self, source, target, *arguments):
        result = self._call("perturb", "detections", source, target, "--classes", self._classes, *arguments)
        if result.returncode != 0:
            raise Failure(result.stderr.strip())

    def _call(self, name, *arguments):
        command = [os.path.join(self._programs, name), *arguments]
        return subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True)

    def _list_parameters(self):
        listing = self._call("offline", "--list-parameters").stdout
        return set(re.findall(r"^\| `([^`]+)` \|", listing, re.MULTILINE))

    def _settings(self, method):
        """The method's settings that the program knows; the others are noted."""
        for setting in method.settings:
            key = setting.split("=")[0]
            if key in self._parameters:
                yield from ("--set", setting)
            else:
                self._note(f"`{key}` is no parameter of this version and was left out.")

    def _note(self, text):
        if text not in self.notes:
            self.notes.append(text)

    def _run(self, sequence, method):
        run = Run(sequence, method, os.path.join(self._output, "runs", sequence.name, method.key))
        os.makedirs(run.directory, exist_ok=True)
        result = self._call("offline", "--trajectory", sequence.trajectory, "--detections", sequence.detections,
                            "--camera", os.path.join(self._cameras, sequence.camera), "--classes", self._classes,
                            "--output", run.directory, *self._settings(method))
        if result.returncode != 0:
            errors = [line for line in result.stderr.splitlines() if "error" in line] or ["no message"]
            run.problem = errors[0].replace("offline: error: ", "")
            self._note(f"{method.title} is not available on {sequence.name}: {run.problem}.")
            return run
        speed = re.search(r"([0-9.]+) x real time", result.stdout)
        run.times_real_time = float(speed.group(1)) if speed else 0.0
        with open(os.path.join(run.directory, "summary.json")) as file:
            run.summary = json.load(file)
        if sequence.reference:
            run.objects = self._evaluate_objects(run)
        return run

    def _evaluate_objects(self, run):
        path = os.path.join(run.directory, "evaluation_objects.json")
        result = self._call("evaluate", "objects", run.directory, run.sequence.ground_truth, run.sequence.reference,
                            "--json", path)
        if result.returncode != 0:
            raise Failure(result.stderr.strip())
        with open(path) as file:
            return json.load(file)
