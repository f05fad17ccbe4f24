"""Prints the paper's tables with its figures beside ours; see scripts/paper_tables."""

import argparse
import os
import sys

import association_tables
import correction_table
import loop_table
import odometry_table
import robustness_table
import sessions_table
import trajectory_table
from association_tables import FULL
from runs import (JDA, JOINT, Failure, Programs, cascade, default_data, find_image_sequences, find_sequences,
                  package_folder)

PACKAGE = package_folder()

# Name on the command line -> function of the context that gives Markdown.
TABLES = {
    "I": association_tables.table_1,
    "II": association_tables.table_2,
    "III": loop_table.table_3,
    "IV": trajectory_table.table_4,
    "timing": association_tables.table_timing,
    "robustness": robustness_table.table_robustness,
    "odometry": odometry_table.table_odometry,
    "objects": correction_table.table_objects,
    "sessions": sessions_table.table_sessions,
}
VIEWS = ((FULL, "MLV-ODA, the paper's cascade"), (cascade("2d"), "2D"), (cascade("pro"), "Pro"), (cascade("3d"), "3D"),
         (JDA, "JDA"), (JOINT, "joint assignment (default)"))


class Context:
    """What a table needs: the programs, the sequences and a folder for inputs of its own."""

    def __init__(self, arguments):
        self.programs = Programs(arguments.programs, arguments.output)
        self.sequences = find_sequences(arguments.data, arguments.reference)
        self.image_sequences = find_image_sequences(arguments.data)
        self.output = arguments.output  # for pictures and curves
        self.pictures = not arguments.no_pictures
        self.inputs = os.path.join(arguments.output, "inputs")  # made here from recorded ones


def default_output():
    """Beside a checkout's build; below the current folder if the package is installed."""
    build = os.path.join(PACKAGE, "build-catkin")
    return os.path.join(build if os.path.isdir(build) else os.getcwd(), "paper_tables")


def parse_arguments():
    parser = argparse.ArgumentParser(prog="paper_tables", description=__doc__)
    parser.add_argument("--programs", default=os.path.join(PACKAGE, "build-catkin/devel/lib/semantic_topo_loop"),
                        help="folder of the programs offline and evaluate (default: the built ones)")
    parser.add_argument("--data", default=default_data(),
                        help="folder of tum/fr2_desk, tum/fr3_office (default: SEMANTIC_TOPO_LOOP_DATA, ../shared)")
    parser.add_argument("--reference", default="", metavar="FILE", help="reference objects of fr3_office, CSV")
    parser.add_argument("--output", default=default_output(), metavar="DIR",
                        help="folder for the runs, the pictures and tables.md (default: %(default)s)")
    parser.add_argument("--tables", default=",".join(TABLES), metavar="LIST",
                        help="comma-separated choice (default: %(default)s)")
    parser.add_argument("--no-pictures", action="store_true", help="tables and curves only; matplotlib is not needed")
    arguments = parser.parse_args()
    arguments.tables = [name for name in arguments.tables.split(",") if name]
    unknown = [name for name in arguments.tables if name not in TABLES]
    if unknown:
        parser.error(f"unknown table '{unknown[0]}' (known: {', '.join(TABLES)})")
    if arguments.reference and not os.path.exists(arguments.reference):
        parser.error(f"--reference '{arguments.reference}' does not exist")
    return arguments


def views(context, output):
    # Needs matplotlib, which the tables do not.
    import top_view

    paths = []
    for sequence in context.sequences:
        runs = [(context.programs.run(sequence, method), title) for method, title in VIEWS]
        paths += top_view.save_views(runs, output)
    return "### Top views\n\n" + "".join(f"![{os.path.basename(p)[:-4]}]({os.path.basename(p)})\n" for p in paths)


def main():
    arguments = parse_arguments()
    try:
        context = Context(arguments)
        os.makedirs(context.inputs, exist_ok=True)
        parts = [TABLES[name](context) for name in arguments.tables]
        if context.pictures and {"I", "II"} & set(arguments.tables):
            parts.append(views(context, arguments.output))
    except Failure as failure:
        sys.exit(f"paper_tables: error: {failure}")
    if context.programs.notes:
        parts.append("### Notes\n\n" + "".join(f"- {note}\n" for note in context.programs.notes))
    text = "\n".join(parts)
    sys.stdout.write(text)
    with open(os.path.join(arguments.output, "tables.md"), "w") as file:
        file.write(text)


if __name__ == "__main__":
    main()
