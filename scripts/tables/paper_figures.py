"""What the paper (SemanticTopoLoop, arXiv 2311.02831) prints, and how its cells are written beside ours."""

NOT_PRINTED = "-"  # the paper has no such figure

# Table I, MLV-ODA: sequence -> (frames, constructed, real, true positive, precision, recall, F), the last three in per
# cent. Sequences by our names; None is the paper's average.
OBJECTS = {
    "fr1_room": (1352, 17, 19, 16, 94.12, 84.21, 88.89),
    "fr2_desk": (2893, 14, 16, 14, 100.00, 87.50, 93.33),
    "fr2_dishes": (1706, 5, 6, 5, 100.00, 83.33, 90.91),
    "fr3_office": (2488, 24, 26, 23, 95.83, 88.46, 92.00),
    None: (2109.75, 15, 16.75, 14.5, 97.49, 85.88, 91.31),
}

# Table II, fr2_desk: key of our method -> (paper's name, constructed, true positive, precision, recall, F).
ABLATION_SEQUENCE, ABLATION_REAL = "fr2_desk", 16
ABLATION = {
    "cascade_2d": ("2D-ODA", 125, 1, 0.80, 6.25, 1.42),
    "cascade_3d": ("3D-ODA", 9, 9, 100.00, 56.25, 72.00),
    "cascade_pro": ("Pro-ODA", 17, 13, 76.47, 81.25, 78.79),
    "cascade": ("MLV-ODA", 14, 14, 100.00, 87.50, 93.33),
}

# Mean association time of a frame after so many frames, ms: (sequence, frames) -> (JDA, MLV-ODA).
ASSOCIATION_MACHINE = "AMD Ryzen 7 5800H"
ASSOCIATION_MS = {
    ("fr2_desk", 10): (0.0758, 0.0454),
    ("fr2_desk", 100): (0.1867, 0.0420),
    ("fr2_desk", 1000): (2.8692, 0.0418),
    ("fr3_office", 10): (0.0128, 0.0812),
    ("fr3_office", 100): (0.1907, 0.0732),
    ("fr3_office", 1000): (2.9550, 0.0450),
}

# What counts as a loop in Table III: key of `evaluate loops` -> in words.
CRITERIA = (
    ("paper", "the paper's criterion C1: within 3 m and 80 deg between the optical axes, more than 1000 frames apart"),
    ("original", "the original criterion of SmSLAM+LCD: within 1 m and 53 deg, more than 1000 frames apart"),
    ("objects", "C2: more than 2 common objects, more than 500 frames apart"),
)

# Table III: (sequence, criterion) -> rows of (method, keyframes, reference loops, real loops, true positives, precision,
# recall), the last two in per cent. Reference loops are pairs of keyframes.
LOOPS = {
    ("fr2_desk", "paper"): (("ORB-SLAM2", 193, 1697, 176, 33, 18.75, 1.94), ("ORB-SLAM3", 261, 2774, 361, 66, 18.28, 2.38),
                            ("Ours-C1", 192, 2079, 45, 45, 100, 2.16)),
    ("fr2_desk", "original"): (("SmSLAM+LCD", None, 2122, 23, 23, 100, 1.08),),
    ("fr2_desk", "objects"): (("SemanticLoop", None, None, 44, 44, 100, None), ("Ours-C2", None, None, 55, 55, 100, None)),
    ("fr3_office", "paper"): (("ORB-SLAM2", 239, 1773, 209, 16, 7.66, 0.90), ("ORB-SLAM3", 293, 2654, 504, 53, 10.52, 2.00),
                              ("Ours-C1", 274, 2188, 25, 25, 100, 1.14)),
    ("fr3_office", "original"): (("SmSLAM+LCD", None, 2429, 6, 6, 100, 0.25),),
    ("fr3_office", "objects"): (("SemanticLoop", None, None, 76, 76, 100, None), ("Ours-C2", None, None, 85, 85, 100, None)),
}

# Table IV: ATE after loop closure, m: (sequence, metric) -> a figure a method.
TRAJECTORY_METHODS = ("ORB-SLAM2", "ORB-SLAM3", "Lin et al.", "SmSLAM+LCD", "SemanticLoop", "Ours")
TRAJECTORIES = {
    ("fr2_desk", "rmse"): (0.008, 0.018, 0.014, 0.008, 0.042, 0.0078),
    ("fr2_desk", "mean"): (0.008, 0.017, None, None, None, 0.0072),
    ("fr2_desk", "median"): (0.007, 0.015, None, None, None, 0.0068),
    ("fr3_office", "rmse"): (0.012, 0.012, 0.016, 0.009, 0.015, 0.0087),
    ("fr3_office", "mean"): (0.011, 0.011, None, None, None, 0.0079),
    ("fr3_office", "median"): (0.009, 0.010, None, None, None, 0.0075),
}


def cell(figure):
    """As the paper prints it."""
    return NOT_PRINTED if figure is None else f"{figure:g}"


def percent(figure):
    return NOT_PRINTED if figure is None else f"{figure:.2f} %"


def object_cells(figures):
    """@param figures a row of OBJECTS, or None"""
    return [*map(cell, figures[:4]), *map(percent, figures[4:])] if figures else [NOT_PRINTED] * 7


def ablation_cells(sequence, method):
    """Constructed, true positive, precision, recall, F of Table II's row of a method or, for the whole cascade, of the
    sequence's row of Table I."""
    if sequence == ABLATION_SEQUENCE and method in ABLATION:
        _, *figures = ABLATION[method]
        return [*map(cell, figures[:2]), *map(percent, figures[2:])]
    _, constructed, _, *others = object_cells(OBJECTS.get(sequence) if method == "cascade" else None)
    return [constructed, *others]


def loop_cells(row):
    """@param row one of LOOPS"""
    return [*map(cell, row[1:5]), *map(percent, row[5:])]
