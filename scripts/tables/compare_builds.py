"""Runs two builds on the same inputs and compares their result files byte by byte, timing.csv and memory.csv aside.

A build is a catkin build directory (with devel/ in it). The runs: recorded poses, true poses, drifted odometry, an
odometry that restarts, corrupted detections, rendered images, real images, a bag through the nodelets in lockstep."""

import argparse
import dataclasses
import filecmp
import os
import shutil
import subprocess
import sys
import time

from inputs import restarted
from robustness_table import corrupted
from runs import Failure, Programs, default_data, find_sequences, package_folder

CONFIG = os.path.join(package_folder(), "config")
# Of every sequence, one that drifts steadily and one that jumps.
DRIFTED = ("smooth_1m_15deg_s1.txt", "jump_1m_15deg_s2.txt")
CLASSES = os.path.join(CONFIG, "classes_coco.yaml")
RENDERED_S = 20


class Context:
    """What the tables' inputs are made with: the first build's programs."""

    def __init__(self, build, output):
        self.inputs = os.path.join(output, "inputs")
        os.makedirs(self.inputs, exist_ok=True)
        self.programs = Programs(programs_of(build), output)


def programs_of(build):
    return os.path.join(build, "devel/lib/semantic_topo_loop")


def call(build, name, *arguments):
    result = subprocess.run([os.path.join(programs_of(build), name), *arguments], stdout=subprocess.PIPE,
                            stderr=subprocess.STDOUT, universal_newlines=True)
    if result.returncode != 0:
        raise Failure(f"{name} of {build}: {result.stdout.strip()}")


def recorded(context, data):
    """Name -> arguments of `offline` for every run on recorded detections."""
    runs = {}
    for sequence in find_sequences(data, ""):
        chosen = [dataclasses.replace(sequence, name=f"{sequence.name}_{os.path.basename(path)[:-4]}", trajectory=path)
                  for path in sequence.drifted if os.path.basename(path) in DRIFTED]
        chosen += [restarted(context, sequence, 1), corrupted(context, sequence, 1)]
        for run in [sequence, *chosen]:
            runs[run.name] = ["--trajectory", run.trajectory, "--detections", run.detections, "--camera",
                              os.path.join(CONFIG, "camera", run.camera)]
    return runs


def rendered(context, build):
    folder = os.path.join(context.inputs, "rendered")
    call(build, "simulate", "--output", folder, "--duration", str(RENDERED_S), "--images", "true", "--bag",
         os.path.join(folder, "sequence.bag"), "--camera", os.path.join(CONFIG, "camera/tum_fr2.yaml"), "--classes",
         CLASSES)
    return folder


def with_images(data, rendered_folder):
    runs = {"rendered": ["--rgbd", rendered_folder, "--detections", os.path.join(rendered_folder, "detections.json"),
                         "--camera", os.path.join(rendered_folder, "camera.yaml")]}
    folder = os.path.join(data, "tum/fr1_xyz")
    if os.path.isdir(folder):
        runs["fr1_xyz"] = ["--rgbd", folder, "--set", "depth.scale=5000", "--detections",
                           os.path.join(folder, "detections_yolox_nano.json"), "--camera",
                           os.path.join(CONFIG, "camera/tum_fr1.yaml")]
    return runs


def play(build, rendered_folder, output):
    """tum.launch in lockstep, in the build's own environment."""
    arguments = [f"bag:={rendered_folder}/sequence.bag", f"detections:={rendered_folder}/detections.json",
                 f"camera:={rendered_folder}/camera.yaml", f"output:={output}"]
    setup = os.path.join(os.path.abspath(build), "devel/setup.bash")
    result = subprocess.run(["bash", "-c", '. "$0" && exec roslaunch semantic_topo_loop tum.launch "$@"', setup,
                             *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True)
    if "player: finished" not in result.stdout:
        raise Failure(f"tum.launch of {build}: {result.stdout[-2000:]}")


def differing(one, other):
    """Names of the files that differ or that only one folder has."""
    names = [sorted(set(os.listdir(folder)) - {"timing.csv", "memory.csv"}) for folder in (one, other)]
    return sorted(set(names[0]) ^ set(names[1])) + [
        name for name in names[0] if name in names[1]
        and not filecmp.cmp(os.path.join(one, name), os.path.join(other, name), shallow=False)]


def compare(name, builds, output, run):
    """@return whether both builds wrote the same bytes"""
    folders = [os.path.join(output, label, name) for label in ("first", "second")]
    seconds = []
    for build, folder in zip(builds, folders):
        shutil.rmtree(folder, ignore_errors=True)
        os.makedirs(folder)
        start = time.monotonic()
        run(build, folder)
        seconds.append(time.monotonic() - start)
    files = differing(*folders)
    verdict = "DIFFER: " + ", ".join(files) if files else f"the same {len(os.listdir(folders[0])) - 2} files"
    print(f"{name}: {verdict} ({seconds[0]:.1f} s, {seconds[1]:.1f} s)", flush=True)
    return not files


def parse_arguments():
    parser = argparse.ArgumentParser(prog="compare_builds", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", help="build directory of the version that is taken as right")
    parser.add_argument("second", help="build directory of the version that is judged")
    parser.add_argument("--data", default=default_data(), help="folder of tum/")
    parser.add_argument("--output", default="/tmp/semantic_topo_loop_comparison", metavar="DIR",
                        help="folder for inputs and results (default: %(default)s)")
    parser.add_argument("--only", default="", metavar="TEXT", help="only the runs whose name contains it")
    return parser.parse_args()


def main():
    arguments = parse_arguments()
    builds = (arguments.first, arguments.second)
    try:
        context = Context(arguments.first, arguments.output)
        runs = recorded(context, arguments.data)
        folder = rendered(context, arguments.first)
        runs.update(with_images(arguments.data, folder))
        same = [compare(name, builds, arguments.output,
                        lambda build, to, values=values: call(build, "offline", *values, "--classes", CLASSES, "--output", to))
                for name, values in runs.items() if arguments.only in name]
        if arguments.only in "lockstep":
            same.append(compare("lockstep", builds, arguments.output, lambda build, to: play(build, folder, to)))
    except Failure as failure:
        sys.exit(f"compare_builds: error: {failure}")
    if not same:
        sys.exit(f"compare_builds: error: no run's name contains '{arguments.only}'")
    print(f"{sum(same)} of {len(same)} runs give the same bytes")
    sys.exit(0 if all(same) else 1)


if __name__ == "__main__":
    main()
