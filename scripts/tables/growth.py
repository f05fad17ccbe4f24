"""What an hour of work costs more than the first minute: a recording that is gone through forwards, backwards, forwards,
and so on, through `offline`. Time and memory of each eighth of the run (of each hour, if there are several), the end,
and the loops; of a simulated sequence also how many accepted loops are right."""

import argparse
import bisect
import json
import os
import re
import subprocess
import sys
import threading
import time
from decimal import Decimal

from inputs import lines_of
from runs import Failure, default_data, find_sequences, package_folder, read_rows

PARTS = 8  # of a run of less than two hours
SETTLED_S = 300.0  # recorded time from which on memory should hardly grow: what is bounded is full
SLOWEST = 0.005  # share of the frames of a part whose mean is printed
COLUMNS = ("association", "mapping", "loop", "optimise")


def to_and_fro(sequence, passes, folder):
    """Writes trajectory.txt, detections.json and groundtruth.txt of `passes` passes; every second one goes backwards.
    A pass begins one image after the one before has ended."""
    def rows(path):
        return [line.split() for line in lines_of(path)]

    poses = rows(sequence.trajectory)
    first, last = Decimal(poses[0][0]), Decimal(poses[-1][0])
    period = ((last - first) / (len(poses) - 1)).quantize(Decimal("0.000001"))

    def repeated(items):
        """(stamp, item) in order of time, of those that lie between the first and the last image."""
        once = [(stamp, item) for stamp, item in items if first - period / 2 < stamp < last + period / 2]
        for i in range(passes):
            start = first + i * (last - first + period)
            for stamp, item in once if i % 2 == 0 else reversed(once):
                yield start + (stamp - first if i % 2 == 0 else last - stamp), item

    def write_poses(path, name):
        with open(os.path.join(folder, name), "w") as file:
            for stamp, values in repeated((Decimal(row[0]), row[1:8]) for row in rows(path)):
                file.write(" ".join([f"{stamp:.6f}", *values]) + "\n")

    os.makedirs(folder, exist_ok=True)
    write_poses(sequence.trajectory, "trajectory.txt")
    write_poses(sequence.ground_truth, "groundtruth.txt")
    with open(sequence.detections) as file:
        images = json.load(file)
    stamped = sorted(((Decimal(os.path.splitext(image["file_name"])[0]), image["detections"]) for image in images),
                     key=lambda pair: pair[0])
    with open(os.path.join(folder, "detections.json"), "w") as file:
        json.dump([{"file_name": f"{stamp:.6f}.png", "detections": boxes} for stamp, boxes in repeated(stamped)], file)


class Memory(threading.Thread):
    """Resident memory of a process once a second: seconds and MB."""

    def __init__(self, pid):
        super().__init__(daemon=True)
        self._status = f"/proc/{pid}/status"
        self.samples = []
        self.start()

    def run(self):
        begin = time.monotonic()
        while True:
            try:
                with open(self._status) as file:
                    found = re.search(r"VmRSS:\s+(\d+)", file.read())
            except OSError:
                return
            if found:
                self.samples.append((time.monotonic() - begin, int(found.group(1)) / 1024))
            time.sleep(1.0)


def run_offline(program, folder, camera, settings, results, map_file):
    config = os.path.join(package_folder(), "config")
    command = [program, "--trajectory", os.path.join(folder, "trajectory.txt"), "--detections",
               os.path.join(folder, "detections.json"), "--camera", camera, "--classes",
               os.path.join(config, "classes_coco.yaml"), "--output", results]
    for setting in settings:
        command += ["--set", setting]
    if map_file:
        command += ["--save-map", map_file]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True)
    memory = Memory(process.pid)
    text = process.communicate()[0]
    if process.returncode != 0:
        raise Failure(text.strip())
    return text.strip().splitlines()[-1], memory.samples


def slowest(values):
    """Mean of the slowest ones."""
    count = max(1, int(len(values) * SLOWEST))
    return sum(sorted(values)[-count:]) / count


def table(frames, memory, seconds, recorded_s):
    """Milliseconds a frame by part of the run. What is in no frame is the end: the last optimisation."""
    hours = round(recorded_s / 3600.0)
    parts, name = (hours, "hour") if hours > 1 else (PARTS, "part")
    print(f"| {name} | ms a frame | slowest 0.5 %: " + " | ".join(COLUMNS) + " | MB at its end |")
    print("| --- " * (len(COLUMNS) + 3) + "|")
    spent_us = [0.0]
    for row in frames:
        spent_us.append(spent_us[-1] + sum(float(row[name + "_us"]) for name in COLUMNS))
    whole_us = spent_us[-1]
    begin_s = memory[-1][0] - seconds if memory else 0.0  # before, files are read

    def memory_mb(frame):
        """Memory is sampled by the clock; the clock runs with the work."""
        at = bisect.bisect(memory, (begin_s + seconds * spent_us[frame] / whole_us,))
        return memory[min(at, len(memory) - 1)][1] if memory else 0.0

    for part in range(parts):
        begin, end = part * len(frames) // parts, (part + 1) * len(frames) // parts
        cells = [slowest([float(row[name + "_us"]) for row in frames[begin:end]]) / 1000 for name in COLUMNS]
        print(f"| {part + 1} of {parts} | {(spent_us[end] - spent_us[begin]) / (end - begin) / 1000:.2f} | "
              + " | ".join(f"{cell:.1f}" for cell in cells) + f" | {memory_mb(end):.0f} |")
    print(f"\nin no frame (rows of results, the end): {seconds - whole_us / 1e6:.2f} s; most memory: "
          f"{max((mb for _, mb in memory), default=0):.0f} MB")
    if recorded_s > 2 * SETTLED_S:
        last_s = recorded_s - 60.0  # the end of the run, which writes its files, is not growth
        grown_mb = (memory_mb(int(len(frames) * last_s / recorded_s))
                    - memory_mb(int(len(frames) * SETTLED_S / recorded_s)))
        print(f"memory from minute {SETTLED_S / 60:.0f} to {last_s / 60:.0f}: "
              f"{60 * grown_mb / (last_s - SETTLED_S):.2f} MB a minute")


def parse_arguments():
    parser = argparse.ArgumentParser(prog="growth", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", help="folder of the programs offline and evaluate")
    parser.add_argument("--passes", type=int, default=16, help="how often fr2_desk is gone through (default: 16)")
    parser.add_argument("--data", default=default_data(), help="folder of tum/")
    parser.add_argument("--output", default="/tmp/semantic_topo_loop_growth", metavar="DIR",
                        help="folder for inputs and results (default: %(default)s)")
    parser.add_argument("--inputs-only", action="store_true", help="only write the input")
    parser.add_argument("--folder", help="instead of fr2_desk: a folder that `simulate` wrote")
    parser.add_argument("--save-map", metavar="FILE", help="write the map there while it is made, and say how big it is")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of offline")
    return parser.parse_args()


def main():
    arguments = parse_arguments()
    try:
        folder, camera = arguments.folder, os.path.join(arguments.folder or "", "camera.yaml")
        if folder is None:
            sequence = find_sequences(arguments.data, "")[0]
            folder = os.path.join(arguments.output, f"{sequence.name}_{arguments.passes}")
            camera = os.path.join(package_folder(), "config/camera", sequence.camera)
            to_and_fro(sequence, arguments.passes, folder)
            print("input: " + folder)
        elif not os.path.exists(os.path.join(folder, "trajectory.txt")):
            os.symlink("odometry.txt", os.path.join(folder, "trajectory.txt"))
        if arguments.inputs_only:
            return
        results = os.path.join(arguments.output, "results", os.path.basename(folder))
        said, memory = run_offline(os.path.join(arguments.programs, "offline"), folder, camera, arguments.set, results,
                                   arguments.save_map)
        print(said + "\n")
        seconds = float(re.search(r"in ([0-9.]+) s", said).group(1))
        recorded_s = seconds * float(re.search(r"([0-9.]+) x real time", said).group(1))
        table(read_rows(os.path.join(results, "timing.csv")), memory, seconds, recorded_s)
        with open(os.path.join(results, "summary.json")) as file:
            print("loops: " + json.dumps(json.load(file).get("loops", {})))
        if arguments.save_map:
            size_mb = os.path.getsize(arguments.save_map) / 1e6
            print(f"map: {size_mb:.0f} MB, {3600 * size_mb / recorded_s:.0f} MB an hour")
        truth = os.path.join(folder, "groundtruth_frames.txt")
        if os.path.exists(truth):
            judged = subprocess.run([os.path.join(arguments.programs, "evaluate"), "loops", results, truth],
                                    stdout=subprocess.PIPE, check=True, universal_newlines=True).stdout
            print("\n".join(line for line in judged.splitlines() if line.startswith("right within")))
    except Failure as failure:
        sys.exit(f"growth: error: {failure}")


if __name__ == "__main__":
    main()
