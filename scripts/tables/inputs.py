"""Inputs of the tables of loops and trajectories: recorded odometry, drifted odometry, odometry that restarts."""

import dataclasses
import math
import os
import random
import re

UNDRIFTED = "no drift"
LEVELS = ("0.3 m / 5 deg", "1 m / 15 deg", "2 m / 30 deg")
RESTART_SEEDS = (1, 2, 3)


def drifted(sequence):
    """@return (level, sequence) for every drifted file"""
    return [(level_of(path), replaced(sequence, path)) for path in sequence.drifted]


def level_of(path):
    """`jump_1m_15deg_s1.txt` has the level `1 m / 15 deg`."""
    match = re.search(r"_([0-9.]+)m_([0-9.]+)deg_", os.path.basename(path))
    return f"{match.group(1)} m / {match.group(2)} deg" if match else "?"


def replaced(sequence, path):
    """The sequence with another odometry; its objects are not judged."""
    stem = os.path.splitext(os.path.basename(path))[0]
    return dataclasses.replace(sequence, name=f"{sequence.name}_{stem}", trajectory=path, reference="")


def thinned(context, sequence, step):
    """The sequence with every `step`th pose; images without a pose are left out by `offline`."""
    stem = os.path.splitext(os.path.basename(sequence.trajectory))[0]
    folder = os.path.join(context.inputs, sequence.name)
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, f"{stem}_every_{step}.txt")
    with open(path, "w") as file:
        file.writelines(lines_of(sequence.trajectory)[::step])
    return dataclasses.replace(sequence, name=f"{sequence.name}_every_{step}", trajectory=path)


def lines_of(path):
    """Of a TUM file, without comments."""
    with open(path) as file:
        return [line for line in file if line.strip() and not line.startswith("#")]


def moved(lines, generator):
    """The poses in another frame, turned and displaced at random."""
    rotation, translation = random_motion(generator)
    for line in lines:
        stamp, *values = line.split()
        values = [float(value) for value in values]
        position = [a + b for a, b in zip(rotate(rotation, values[:3]), translation)]
        yield " ".join([stamp, *(f"{v:.9f}" for v in position + multiply(rotation, values[3:]))]) + "\n"


def restarted(context, sequence, seed):
    """The sequence with an odometry that starts in another frame, turned and displaced at random, in the middle."""
    folder = os.path.join(context.inputs, sequence.name)
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, f"restart_s{seed}.txt")
    lines = lines_of(sequence.trajectory)
    with open(path, "w") as file:
        file.writelines(lines[:len(lines) // 2])
        file.writelines(moved(lines[len(lines) // 2:], random.Random(seed)))
    return replaced(sequence, path)


def random_motion(generator):
    """A uniformly random rotation (x, y, z, w) and a translation of up to 5 m along each axis."""
    values = [generator.gauss(0.0, 1.0) for _ in range(4)]
    norm = math.sqrt(sum(v * v for v in values))
    return [v / norm for v in values], [generator.uniform(-5.0, 5.0) for _ in range(3)]


def multiply(a, b):
    """Product of two quaternions (x, y, z, w)."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return [aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz]


def rotate(rotation, vector):
    inverse = [-rotation[0], -rotation[1], -rotation[2], rotation[3]]
    return multiply(multiply(rotation, [*vector, 0.0]), inverse)[:3]
