# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Reference pages that are generated from the code: commands, parameters, Python API."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mp_pca_planner
from mp_pca_planner.cli.main import COMMANDS
from mp_pca_planner.execution.parameters import DECLARATIONS


def write_pages(folder: Path) -> None:
    """Write `commands.md`, `parameters.md` and `python.md`."""
    folder.mkdir(exist_ok=True)
    for name, content in (
        ("commands", commands_page()),
        ("parameters", parameters_page()),
        ("python", python_page()),
    ):
        (folder / f"{name}.md").write_text(content, encoding="utf-8")


def commands_page() -> str:
    """The help of every command but the node, which has only ROS arguments."""
    parts = [
        "# Commands",
        "Each is `ros2 run mp_pca_planner COMMAND` or `python3 -m mp_pca_planner COMMAND`.",
    ]
    for name in COMMANDS:
        text = subprocess.run(
            [sys.executable, "-m", "mp_pca_planner", name, "--help"],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        parts += [f"## {name}", f"```text\n{text.rstrip()}\n```"]
    return "\n\n".join(parts) + "\n"


def parameters_page() -> str:
    """The parameters of the node as a table."""
    rows = [
        f"| `{one.name}` | {_cell(one.default)} | {one.accepted} | {one.description} |".replace(
            "~", "\\~"
        )
        for one in DECLARATIONS
    ]
    return "\n".join(
        [
            "# Parameters of the node",
            "",
            "All can be changed while the node runs. An invalid value is rejected, and the old one "
            "stays. Further parameters are `limits.JOINT.max_velocity`, `max_acceleration`, "
            "`max_jerk` and `max_effort`, once the joints are known.",
            "",
            "| name | default | accepted | |",
            "|---|---|---|---|",
            *rows,
            "",
        ]
    )


def _cell(default: object) -> str:
    if isinstance(default, tuple):
        return "`[" + ", ".join(map(repr, default)) + "]`"
    return f"`{str(default).lower() if isinstance(default, bool) else default!r}`"


def python_page() -> str:
    """The public names with their docstrings."""
    parts = ["# Python API", "`import mp_pca_planner as mp`: every name below is `mp.NAME`."]
    for name in mp_pca_planner.__all__:
        kind = "class" if isinstance(getattr(mp_pca_planner, name), type) else "function"
        options = "\n   :members:" if kind == "class" else ""
        parts += [
            f"## {name}",
            f"```{{eval-rst}}\n.. auto{kind}:: mp_pca_planner.{name}{options}\n```",
        ]
    return "\n\n".join(parts) + "\n"
