"""What the paper (SemanticTopoLoop, arXiv 2311.02831) prints, by the keys of our methods. Only known figures
are entered; every other cell is shown as n/a."""

# Tables I and II: sequence -> method -> (precision, recall, F).
OBJECTS = {}

# Mean association time of a frame, us: method -> value. MLV-ODA on a Ryzen 5800H.
ASSOCIATION_US = {"cascade": 42.0}
ASSOCIATION_MACHINE = "AMD Ryzen 5800H"

# Table III: sequence -> row's title -> (keyframes, reference loops, real loops, true positives, precision, recall).
LOOPS = {}
LOOP_TITLE = "the paper's own row"

# What counts as a loop in Table III: key of `evaluate loops` -> in words.
CRITERIA = (
    ("paper", "the paper's criterion: within 3 m and 80 deg between the optical axes, more than 1000 frames apart"),
    ("original", "the original criterion of SmSLAM+LCD: within 1 m and 53 deg, more than 1000 frames apart"),
    ("objects", "more than 2 common objects, more than 500 frames apart"),
)

# Table IV: sequence -> (ATE before: RMSE, mean, median, after: RMSE, mean, median), metres.
TRAJECTORIES = {}

NOT_AVAILABLE = "n/a"


def objects(sequence, method):
    """The three figures as texts."""
    figures = OBJECTS.get(sequence, {}).get(method)
    if figures is None:
        return (NOT_AVAILABLE,) * 3
    return tuple(f"{value:.3f}" for value in figures)


def association_us(method):
    value = ASSOCIATION_US.get(method)
    return NOT_AVAILABLE if value is None else f"{value:g}"


def loops(sequence):
    """The six figures as texts."""
    return texts(LOOPS.get(sequence), 6)


def trajectory(sequence):
    """The six figures as texts."""
    return texts(TRAJECTORIES.get(sequence), 6)


def texts(figures, count):
    return (NOT_AVAILABLE,) * count if figures is None else tuple(f"{value:g}" for value in figures)
