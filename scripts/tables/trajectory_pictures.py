"""Top and side views of a trajectory before and after loops, beside the truth; trajectory files and their alignment."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

ASSOCIATION_TOLERANCE_S = 0.02
HOLE_S = 0.1  # the truth's line is broken over wider gaps
BREAK_M = 0.3  # and a path's over longer steps
MARGIN_M = 0.2
# Colour and width; the lower line is the wider one, so that equal paths are both seen.
STYLES = (("before", "#d95f02", 2.0), ("after", "#1f5fb4", 1.1))


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


def true_path(ground_truth):
    stamps, positions, _ = read_poses(ground_truth)
    holes = np.flatnonzero(np.diff(stamps) > HOLE_S) + 1
    return np.insert(positions, holes, np.nan, axis=0)


def broken(path):
    """The path without the lines over its jumps."""
    jumps = np.flatnonzero(np.linalg.norm(np.diff(path, axis=0), axis=1) > BREAK_M) + 1
    return np.insert(path, jumps, np.nan, axis=0)


def aligned_path(path, ground_truth):
    rotation, translation, positions = align(path, ground_truth)
    return positions @ rotation.T + translation


def draw(axes, vertical, truth, paths, comparison):
    """@param vertical the coordinate upwards: 1 for the top view, 2 for the side view"""
    axes.set_aspect("equal")
    axes.grid(color="0.93")
    axes.set_axisbelow(True)
    axes.plot(truth[:, 0], truth[:, vertical], color="0.72", linewidth=5.0, solid_capstyle="butt",
              label="truth (motion capture)")
    for (when, color, line_width), positions, figures in zip(STYLES, paths, (comparison.before, comparison.after)):
        line = broken(positions)
        axes.plot(line[:, 0], line[:, vertical], color=color, linewidth=line_width,
                  label=f"{when}, ATE {figures['ate_m']['rmse']:.4f} m")
    axes.plot(paths[1][0, 0], paths[1][0, vertical], marker="o", color="black", markersize=6, linestyle="",
              label="start")
    axes.set_ylabel(f"{'xyz'[vertical]}, m")


def save(comparison, path):
    """@param comparison a trajectory_table.Comparison"""
    sequence = comparison.sequence
    truth = true_path(sequence.ground_truth)
    paths = [aligned_path(file, sequence.ground_truth) for file in (sequence.trajectory, comparison.run.trajectory)]
    points = np.vstack([truth[~np.isnan(truth[:, 0])], *paths])
    low, high = points.min(0) - MARGIN_M, points.max(0) + MARGIN_M
    width, *heights = high - low
    scale = min(7.2 / width, 11.0 / sum(heights))  # inches a metre
    figure, grid = plt.subplots(2, 1, sharex=True, dpi=110, gridspec_kw={"height_ratios": heights, "hspace": 0.05},
                                figsize=(scale * width + 1.0, scale * sum(heights) + 1.6))
    for axes, vertical in zip(grid, (1, 2)):
        draw(axes, vertical, truth, paths, comparison)
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[vertical], high[vertical])
    grid[0].set_title(f"{sequence.name}\nfrom above and from the side, each aligned with the truth by SE(3)",
                      fontsize=10)
    grid[1].set_xlabel("x, m")
    grid[1].legend(loc="upper center", bbox_to_anchor=(0.5, -0.5 / (scale * heights[1])), ncol=4, fontsize=8,
                   frameon=False)
    figure.savefig(path, bbox_inches="tight")
    plt.close(figure)
