# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`inspect`: the content of recordings and primitive files."""

from __future__ import annotations

import argparse
from typing import Any

from ..control.law import control_statement
from ..exceptions import PlannerError, listed
from ..primitives.file import load_primitive
from ..recordings.bags import find_recordings
from ..recordings.reading import inspect_recording
from .common import fact_lines, primitive_lines, print_json
from .options import add_bag_topic, add_json, add_units, reading_options
from .terminal import DONE, PROGRAM, REFUSED, complain, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = "Show the contents of recordings and primitive files."
    help_text = "bag, .csv, LeRobot dataset, folder of these, or .npz"
    parser.add_argument("files", metavar="FILE", nargs="+", help=help_text)
    add_bag_topic(parser)
    add_units(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; files that can't be read are reported, the others are shown."""
    reports: list[dict[str, Any]] = []
    status = DONE
    for name in arguments.files:
        try:
            found, lines = _contents(name, arguments)
        except PlannerError as error:
            complain(f"{PROGRAM} inspect: {error}")
            status = REFUSED
            continue
        reports += found
        if not arguments.json:
            say(*lines, "")
    if arguments.json:
        print_json({"files": reports})
    refused = [facts["refusal"] for facts in reports if facts.get("refusal")]
    if len(refused) < len(reports):
        return status
    for reason in refused:
        complain(f"{PROGRAM} inspect: {reason}")
    return REFUSED


def _contents(name: str, arguments: argparse.Namespace) -> tuple[list[dict[str, Any]], list[str]]:
    """The facts of a primitive or of each recording, and their text."""
    if name.endswith(".npz"):
        primitive = load_primitive(name)
        fields = (
            *("name", "joint_names", "coupling", "n_components", "degree"),
            *("explained_variance_ratio", "fit_residual", "metadata", "durations"),
        )
        law = control_statement(primitive)
        facts = {
            "path": name,
            "format": "movement_primitive",
            **{field: getattr(primitive, field) for field in fields},
            **primitive.summary(),
            "control_statement": law,
        }
        return [facts], [*primitive_lines(name, primitive), f"  control law: {law}"]
    options = reading_options(arguments)
    paths = find_recordings([name])
    found = [inspect_recording(path, **options) for path in paths]
    lines = [line for facts in found for line in (*fact_lines(facts), "")]
    refused = [facts["name"] for facts in found if facts["refusal"]]
    if refused and len(found) > 1:
        lines += [f"{len(refused)} of {len(found)} need something: {listed(refused)}", ""]
    return found, lines[:-1]
