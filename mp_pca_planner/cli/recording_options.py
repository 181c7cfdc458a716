# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of the commands that read recordings."""

from __future__ import annotations

import argparse
from typing import Any

from ..arrays import read_values
from ..recordings.reading import scale_of_calibration
from ..renaming import read_rename
from .options import add_rename


def add_bag_topic(parser: argparse._ActionsContainer) -> None:
    """Add the options on the messages of recordings."""
    help_text = "of the bags (default: the only JointState one), or column of LeRobot"
    parser.add_argument("--topic", help=help_text)
    help_text = "field of the topic's messages that is a JointState"
    parser.add_argument("--field", metavar="a.b", help=help_text)
    help_text = "read a damaged .mcap or .bag up to the damage"
    parser.add_argument("--recover", "--salvage", action="store_true", help=help_text)


def add_units(parser: argparse._ActionsContainer) -> None:
    """Add the options on the units and names of the joints of recordings."""
    help_text = "recorded in degrees, but joints with a --scale"
    parser.add_argument("--degrees", action="store_true", help=help_text)
    add_rename(parser, "new name of joints, * for any text (left_*=* strips a prefix)")
    scale: dict[str, Any] = {"metavar": "JOINT=FACTOR", "action": "append", "default": []}
    help_text = "whole factor to rad or m; or LeRobot's calibration FILE.json"
    parser.add_argument("--scale", **scale, help=help_text)


def reading_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """The fields of :class:`.LoadOptions` by these options; without ``=``, a scale is a file."""
    scale: dict[str, float] = {}
    for text in arguments.scale:
        is_value = "=" in text
        scale |= read_values(text, "--scale", "joint") if is_value else scale_of_calibration(text)
    return {
        "topic": arguments.topic,
        "state_field": arguments.field,
        "salvage": arguments.recover,
        "degrees": arguments.degrees,
        "rename": read_rename(arguments.rename),
        "scale": scale,
    }
