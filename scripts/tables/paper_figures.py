"""What the paper (SemanticTopoLoop, arXiv 2311.02831) prints, by the keys of our methods. Only known figures
are entered; every other cell is shown as n/a."""

# Tables I and II: sequence -> method -> (precision, recall, F).
OBJECTS = {}

# Mean association time of a frame, us: method -> value. MLV-ODA on a Ryzen 5800H.
ASSOCIATION_US = {"cascade": 42.0}
ASSOCIATION_MACHINE = "AMD Ryzen 5800H"

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
