"""Trajectory files and their alignment with the truth, for pictures."""

import numpy as np

ASSOCIATION_TOLERANCE_S = 0.02


def read_poses(path):
    """Stamps and T_world_camera's positions and quaternions (x, y, z, w) of a TUM file."""
    rows = np.loadtxt(path, comments="#", ndmin=2)
    return rows[:, 0], rows[:, 1:4], rows[:, 4:8]


def align(path, ground_truth):
    """Rotation and translation that take a trajectory to the ground truth's world (Umeyama 1991, without scale).
    @return rotation, translation, the trajectory's positions"""
    stamps, positions, _ = read_poses(path)
    true_stamps, true_positions, _ = read_poses(ground_truth)
    nearest = np.clip(np.searchsorted(true_stamps, stamps), 1, len(true_stamps) - 1)
    nearest -= stamps - true_stamps[nearest - 1] < true_stamps[nearest] - stamps
    near = np.abs(true_stamps[nearest] - stamps) < ASSOCIATION_TOLERANCE_S
    source, target = positions[near], true_positions[nearest[near]]
    u, _, vt = np.linalg.svd((target - target.mean(0)).T @ (source - source.mean(0)))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ flip @ vt
    return rotation, target.mean(0) - rotation @ source.mean(0), positions
