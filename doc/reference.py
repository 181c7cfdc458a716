# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Pages that are generated: commands, parameters, Python API, results of benchmarks."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from inspect import getdoc
from pathlib import Path
from typing import Any

import mp_pca_planner
from mp_pca_planner.cli.main import COMMANDS
from mp_pca_planner.execution.parameters import DECLARATIONS

RESULTS = Path(__file__).parent / "results"
OTHER = "exceptions"
# Pages of the Python API, by the room of the package that holds their names.
TOPICS = {
    "recordings": "Demonstrations",
    "primitives": "Movement primitives",
    "planning": "Planning",
    "motion": "Goals and trajectories",
    "robot": "Robot and world",
    OTHER: "Errors and helpers",
}
# What a program uses first comes first on the pages; the rest follows by name.
MOST_USED = (
    *("load_demonstrations", "MovementPrimitive", "Planner", "PlannerOptions", "Plan"),
    *("Trajectory", "Pose", "Robot", "JointLimits", "World", "Obstacle", "show", "PlannerError"),
)
# Results, which no program constructs.
RESULT_TYPES = ("MovementPrimitive", "Plan")
_ONE_LINE = 100_000  # characters, so that argparse breaks no line of the help
# A place for a part of a recorded table: its record, title, columns (';' between them) and,
# optionally, the first cell of the rows. It reaches up to the next mark.
_MARKED = re.compile(
    r"(<!-- table (\w+)\n([^\n]+)\ncolumns: ([^\n]+)\n(?:rows: ([^\n]+)\n)?-->\n).*?(<!-- end -->)",
    re.DOTALL,
)


def write_pages(folder: Path) -> None:
    """Write the pages of commands, parameters, results and the Python API."""
    folder.mkdir(exist_ok=True)
    for name, content in (
        ("commands", commands_page()),
        ("parameters", parameters_page()),
        ("results", results_page()),
        *python_pages().items(),
    ):
        (folder / f"{name}.md").write_text(content, encoding="utf-8")


def commands_page() -> str:
    """The help of every command but the node, which has only ROS arguments."""
    parts = [
        "# Commands",
        "In a ROS workspace, `mp-pca COMMAND` is `ros2 run mp_pca_planner COMMAND`.",
    ]
    for name in COMMANDS:
        text = subprocess.run(
            [sys.executable, "-m", "mp_pca_planner", name, "--help"],
            capture_output=True,
            text=True,
            check=True,
            env=os.environ | {"COLUMNS": str(_ONE_LINE)},
        ).stdout
        parts += [f"## {name}", _help_page(text)]
    return "\n\n".join(parts) + "\n"


def _help_page(text: str) -> str:
    """The help of a command, whose paragraphs and options are a line each, as Markdown."""
    usage, *lines = text.splitlines()
    # The options that may be left out are listed below.
    needed = re.sub(r" \[-(?:[^\[\]]|\[[^\]]*\])*\]", "", usage.removeprefix("usage: "))
    parts = [f"```text\n{needed} [OPTIONS]\n```"]
    for line in filter(str.strip, lines):
        if option := re.match(r" {2}(\S.*?)(?: {2,}(\S.*))?$", line):
            term, meaning = option.groups()
            parts.append(f"`{term}`" + (f"\n: {_escaped(meaning)}" if meaning else ""))
        elif line.startswith(" "):  # below an option that is too long for its line
            parts[-1] += f"\n: {_escaped(line.strip())}"
        else:
            is_title = line.endswith(":")
            parts.append(f"**{line[:-1].capitalize()}**" if is_title else _escaped(line))
    return "\n\n".join(parts)


def _escaped(text: str) -> str:
    """A line of help as Markdown, with options and quoted texts as code."""
    pieces = re.split(r"((?<![\w-])--?[a-z][\w-]*|(?<!\w)'[^']+')", text)
    pieces[::2] = [re.sub(r"([\\`*_{}\[\]<>#~|$])", r"\\\1", piece) for piece in pieces[::2]]
    pieces[1::2] = [f"`{piece}`" for piece in pieces[1::2]]
    return "".join(pieces)


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


def python_pages() -> dict[str, str]:
    """The public names with their docstrings: an overview, and a page for each topic.

    A topic is a room of the package that holds public names.
    """
    topics: dict[str, list[str]] = {}
    others = [name for name in mp_pca_planner.__all__ if name not in MOST_USED]
    for name in (*MOST_USED, *others):
        room = getattr(mp_pca_planner, name).__module__.split(".")[1]
        topics.setdefault(TOPICS.get(room, TOPICS[OTHER]), []).append(name)
    example = str(mp_pca_planner.__doc__).split("\n\n", 1)[1].strip()
    overview = ["# Python API", f"Every name below is `mp.NAME`:\n\n```python\n{example}\n```"]
    pages, files = {}, []
    for title in TOPICS.values():
        file = "python_" + title.lower().replace(" ", "_")
        links = [
            f"- [{name}]({file}.md#{name.lower()}): {summary(name)}{_methods(name)}"
            for name in topics[title]
        ]
        overview += [f"## [{title}]({file}.md)", "\n".join(links)]
        pages[file] = "\n\n".join([f"# {title}", *map(_documented, topics[title])]) + "\n"
        files.append(file)
    overview.append("```{toctree}\n:hidden:\n\n" + "\n".join(files) + "\n```")
    return {"python": "\n\n".join(overview) + "\n"} | pages


def summary(name: str) -> str:
    """First line of the docstring of a public name."""
    return (getdoc(getattr(mp_pca_planner, name)) or "").partition("\n")[0]


def _methods(name: str) -> str:
    """The methods of a class, as the end of its line in the overview."""
    value = getattr(mp_pca_planner, name)
    if not isinstance(value, type) or issubclass(value, Exception):
        return ""
    methods = [f"`{one}`" for one in vars(value) if one[0] != "_" and callable(getattr(value, one))]
    return f" Methods: {', '.join(methods)}." if methods else ""


def _documented(name: str) -> str:
    kind = "class" if isinstance(getattr(mp_pca_planner, name), type) else "function"
    signature = "()" if name in RESULT_TYPES else ""
    options = "\n   :members:" if kind == "class" else ""
    return (
        f"## {name}\n\n```{{eval-rst}}\n"
        f".. auto{kind}:: mp_pca_planner.{name}{signature}{options}\n```"
    )


def results_page() -> str:
    """The results that scripts/record_results.py has kept, table by table."""
    parts = [
        "# Recorded results",
        "Each section is what a command printed, with the machine, the date and the commit. "
        "`scripts/record_results.py` records a command anew. Times compare within a section only; "
        "a load above the number of processors makes all of them longer. "
        "[Benchmarks](../benchmarks.md) explains the commands.",
    ]
    for file in sorted(RESULTS.glob("*.json")):
        record = json.loads(file.read_text(encoding="utf-8"))
        parts += [f"## {file.stem.replace('_', ' ').capitalize()}", _origin(record)]
        for title, table in record["tables"].items():
            parts += [f"### {title}", _markdown_table(table["header"], table["rows"])]
    return "\n\n".join(parts) + "\n"


def with_results(page: str) -> str:
    """A page with the recorded tables at their marks; those without a record stay as they are."""

    def block(found: re.Match[str]) -> str:
        begin, name, title, columns, first, end = found.groups()
        file = RESULTS / f"{name}.json"
        if not file.exists():
            return found[0]
        record = json.loads(file.read_text(encoding="utf-8"))
        table = record["tables"][title]
        chosen = [table["header"].index(column) for column in columns.split("; ")]
        rows = [row for row in table["rows"] if first in (None, row[0])]
        header, *rows = ([row[i] for i in chosen] for row in [table["header"], *rows])
        shown = _markdown_table(header, rows)
        return f"{begin}\n{shown}\n\n{_origin(record)}\n\n{end}"

    return _MARKED.sub(block, page)


def _origin(record: dict[str, Any]) -> str:
    before, after = record["load"]
    return (
        f"`{record['command']}`, {record['date']}, commit `{record['commit']}`, "
        f"{record['machine']}, load before and after {before:.1f} and {after:.1f}"
    )


def _markdown_table(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', ' ') for cell in line)} |" for line in lines)
