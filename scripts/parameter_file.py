#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Print config/planner.yaml from the table of parameters.

scripts/parameter_file.py > config/planner.yaml
"""

from __future__ import annotations

import json
from textwrap import indent, wrap

from mp_pca_planner.execution.parameters import DECLARATIONS, limit_declarations

HEADER = """\
Parameters of the node mp_pca_planner: all of them, with their defaults. Units are SI and radians. \
Values can be changed while the node runs (`ros2 param set`); they hold from the next goal on, and \
wrong ones are rejected. The wheels have no `ros2`: change this file, and start the node again \
with `mp-pca planner_node --ros-args --params-file planner.yaml`. Numbers need a decimal point \
(2.0, not 2) except for whole numbers. scripts/parameter_file.py writes this file."""
LIMITS = """\
Limits of single joints, which override those above. They are declared for the joints of the \
primitives; 0.0: as in the limits file or the URDF. For a joint called elbow:"""


def comment(text: str) -> str:
    """A text as lines of comment."""
    return "".join(f"# {line}\n" for line in wrap(text, 94))


def parameter_file() -> str:
    """The text of the file."""
    lines = ""
    for declaration in DECLARATIONS:
        default = declaration.default
        # JSON is YAML.
        value = json.dumps(list(default) if isinstance(default, tuple) else default)
        number = type(default) in (int, float)
        accepted = f" From {declaration.low:g} to {declaration.high:g}." if number else ""
        lines += comment(declaration.description + accepted) + f"{declaration.name}: {value}\n"
    lines += comment(LIMITS) + "# limits:\n#   elbow:\n"
    for declaration in limit_declarations(["elbow"]):
        quantity = declaration.name.rpartition(".")[2]
        unit = declaration.description.partition("[")[2].partition("]")[0]
        lines += f"#     {quantity}: {declaration.default}  # [{unit}]\n"
    return comment(HEADER) + "/**:\n  ros__parameters:\n" + indent(lines, "    ")


if __name__ == "__main__":
    print(parameter_file(), end="")
