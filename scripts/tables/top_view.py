"""Top views of a run's objects (the paper's figures 3 and 4)."""

import os

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch

from runs import read_rows
from trajectory_pictures import align

MARGIN_M = 0.2
PATH_COLOR = "0.75"
REFERENCE_SIZE = {"certain": 7.0, "probable": 5.0, "marginal": 3.0}


def rotation_of(x, y, z, w):
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def numbers(row, names):
    return np.array([float(row[name]) for name in names])


class Object:
    """A confirmed object in the ground truth's world."""

    def __init__(self, row, rotation, translation):
        self.id, self.label = int(row["id"]), row["label"]
        self.center = rotation @ numbers(row, "xyz") + translation
        axes = rotation @ rotation_of(*numbers(row, ("qx", "qy", "qz", "qw")))
        # The outline seen from above: the horizontal block of the shape matrix.
        self.outline = (axes @ np.diag(numbers(row, "abc") ** 2) @ axes.T)[:2, :2]


class Reference:
    def __init__(self, row):
        self.id, self.label, self.certainty = int(row["id"]), row["label"], row["certainty"]
        self.center = numbers(row, "xyz")


class Scene:
    """What one picture shows."""

    def __init__(self, run):
        rotation, translation, positions = align(run.trajectory, run.sequence.ground_truth)
        rows = read_rows(os.path.join(run.directory, "objects.csv"))
        self.run = run
        self.objects = [Object(row, rotation, translation) for row in rows if row["state"] == "confirmed"]
        reference = run.sequence.reference
        self.references = [Reference(row) for row in read_rows(reference)] if reference else []
        self.path = positions @ rotation.T + translation
        matches = run.objects.get("matches", [])
        self.false = {m["object"] for m in matches if m["reference"] < 0}
        self.missed = {m["reference"] for m in matches if m["object"] < 0}

    def points(self):
        """Corners of all outlines, and the references' centres."""
        corners = [o.center[:2] + side * np.sqrt(np.diag(o.outline)) for o in self.objects for side in (-1.0, 1.0)]
        return corners + [r.center[:2] for r in self.references]


def class_colors(scenes):
    labels = sorted({o.label for s in scenes for o in s.objects + s.references})
    # The strong colors without grey (the path) and red (false and missed objects), then the same again darker.
    base = [plt.get_cmap("tab10")(i)[:3] for i in range(10) if i not in (3, 7)]
    return {label: tuple(c * (1.0 - 0.4 * (i // len(base))) for c in base[i % len(base)])
            for i, label in enumerate(labels)}


def limits(scenes, with_path):
    points = np.array([p for s in scenes for p in s.points()])
    if with_path:
        points = np.vstack([points, *(s.path[:, :2] for s in scenes)])
    return points.min(0) - MARGIN_M, points.max(0) + MARGIN_M


def draw_objects(axes, scene, colors, font_size):
    for item in scene.objects:
        values, vectors = np.linalg.eigh(item.outline)
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        width, height = 2.0 * np.sqrt(values[1]), 2.0 * np.sqrt(values[0])
        false = item.id in scene.false
        axes.add_patch(Ellipse(item.center[:2], width, height, angle=angle, facecolor=(*colors[item.label], 0.18),
                               edgecolor="red" if false else colors[item.label], linewidth=1.4,
                               linestyle="--" if false else "-", zorder=3))
    place_labels(axes, scene, colors, font_size)


def place_labels(axes, scene, colors, font_size):
    """Puts each name at the free one of a few places around its object."""
    figure = axes.figure
    renderer = figure.canvas.get_renderer()
    taken = []
    low, high = axes.get_window_extent(renderer).min, axes.get_window_extent(renderer).max
    for item in sorted(scene.objects, key=lambda o: -o.outline.trace()):
        reach = np.sqrt(np.diag(item.outline))
        best = None
        for dx, dy, horizontal, vertical in ((0, 1, "center", "bottom"), (1, 0, "left", "center"),
                                             (0, -1, "center", "top"), (-1, 0, "right", "center"),
                                             (0.7, 0.7, "left", "bottom"), (-0.7, 0.7, "right", "bottom"),
                                             (0.7, -0.7, "left", "top"), (-0.7, -0.7, "right", "top"),
                                             (0, 0, "center", "center")):
            text = axes.annotate(item.label, item.center[:2] + reach * (dx, dy), xytext=(3 * dx, 3 * dy),
                                 textcoords="offset points", ha=horizontal, va=vertical, fontsize=font_size,
                                 color="red" if item.id in scene.false else tuple(0.75 * c for c in colors[item.label]),
                                 fontweight="bold" if item.id in scene.false else "normal", zorder=5)
            box = text.get_window_extent(renderer)
            outside = box.x0 < low[0] or box.y0 < low[1] or box.x1 > high[0] or box.y1 > high[1]
            cost = sum(overlap(box, other) for other in taken) + (1e6 if outside else 0.0)
            if best is None or cost < best[0]:
                if best is not None:
                    best[1].remove()
                best = (cost, text, box)
            else:
                text.remove()
            if cost == 0.0:
                break
        taken.append(best[2])


def overlap(a, b):
    return max(0.0, min(a.x1, b.x1) - max(a.x0, b.x0)) * max(0.0, min(a.y1, b.y1) - max(a.y0, b.y0))


def draw_references(axes, scene, colors):
    for reference in scene.references:
        axes.plot(*reference.center[:2], marker="x", markersize=REFERENCE_SIZE[reference.certainty], zorder=4,
                  color=colors[reference.label], markeredgewidth=1.4 if reference.certainty == "certain" else 0.8)
        if reference.id in scene.missed:
            axes.plot(*reference.center[:2], marker="o", markersize=15, markerfacecolor="none", color="red", zorder=4)


def caption(scene):
    figures = scene.run.objects.get("certain")
    text = f"{len(scene.objects)} objects"
    if figures:
        precision, recall = figures["precision"], figures["recall"]
        text += (f", precision {precision['right']}/{precision['total']}, recall {recall['right']}/{recall['total']}, "
                 f"F {figures['f']:.3f}")
    return text


def draw(axes, scene, title, colors, extent, font_size):
    low, high = extent
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.tick_params(labelsize=font_size)
    axes.grid(color="0.93", zorder=0)
    axes.set_axisbelow(True)
    axes.set_title(f"{title}\n{caption(scene)}", fontsize=font_size + 2)
    axes.plot(*scene.path[:, :2].T, color=PATH_COLOR, linewidth=0.8, zorder=1)
    draw_references(axes, scene, colors)
    axes.figure.canvas.draw()
    draw_objects(axes, scene, colors, font_size)


def legend(figure, scenes):
    handles = [Patch(facecolor="0.9", edgecolor="0.3", label="constructed object"),
               Line2D([], [], color=PATH_COLOR, label="camera path")]
    if any(s.references for s in scenes):
        handles[1:1] = [Patch(facecolor="1", edgecolor="red", linestyle="--", label="no reference object there"),
                        Line2D([], [], marker="x", color="0.3", linestyle="", label="reference object"),
                        Line2D([], [], marker="o", color="red", markerfacecolor="none", markersize=11, linestyle="",
                               label="missed (certain) reference")]
    figure.legend(handles=handles, loc="lower center", ncol=len(handles), fontsize=9, frameon=False)


def margins(figure, top, bottom, left, right):
    """Sets the space around the plots, in inches."""
    width, height = figure.get_size_inches()
    figure.subplots_adjust(left=left / width, right=1.0 - right / width, top=1.0 - top / height, bottom=bottom / height)


def save_views(runs, directory):
    """One picture a run, with the whole camera path, and one of all runs side by side; all runs are of one sequence.
    @param runs (run, title)
    @return the paths written"""
    runs = [(run, title) for run, title in runs if not run.problem]
    scenes = [Scene(run) for run, _ in runs]
    if not scenes or not any(s.points() for s in scenes):
        return []
    colors = class_colors(scenes)
    sequence = runs[0][0].sequence.name
    paths = []
    for scene, (run, title) in zip(scenes, runs):
        paths.append(os.path.join(directory, f"{sequence}_{run.method.key}.png"))
        save_view(scene, f"{sequence}: {title}", colors, limits(scenes, with_path=True), paths[-1])
    paths.append(os.path.join(directory, f"{sequence}_overview.png"))
    save_overview(scenes, [title for _, title in runs], colors, limits(scenes, with_path=False), paths[-1])
    return paths


def save_view(scene, title, colors, extent, path):
    width, height = extent[1] - extent[0]
    figure, axes = plt.subplots(figsize=(12.0, 11.2 * height / width + 1.4), dpi=110)
    margins(figure, top=0.6, bottom=0.8, left=0.6, right=0.2)
    draw(axes, scene, title, colors, extent, 8)
    axes.set_xlabel("x, m", fontsize=9)
    axes.set_ylabel("y, m", fontsize=9)
    legend(figure, [scene])
    figure.savefig(path)
    plt.close(figure)


def save_overview(scenes, titles, colors, extent, path):
    width, height = extent[1] - extent[0]
    columns = min(3, len(scenes))
    lines = -(-len(scenes) // columns)
    figure, grid = plt.subplots(lines, columns, figsize=(6.5 * columns, (6.2 * height / width + 0.75) * lines + 0.6),
                                dpi=110, squeeze=False)
    margins(figure, top=0.5, bottom=0.6, left=0.35, right=0.1)
    figure.subplots_adjust(wspace=0.08, hspace=0.75 / (6.2 * height / width))
    for axes, scene, title in zip(grid.flat, scenes, titles):
        draw(axes, scene, title, colors, extent, 7)
    for axes in list(grid.flat)[len(scenes):]:
        axes.set_visible(False)
    legend(figure, scenes)
    figure.savefig(path)
    plt.close(figure)
