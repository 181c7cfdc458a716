#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Run the commands and programs of README, tutorials and code page, as a reader would.

    python3 scripts/run_documentation.py [PAGE...]           # with the packages of this Python
    python3 scripts/run_documentation.py --fresh [PAGE...]   # in a clone, with a new environment

Blocks of the languages ``bash`` and ``python`` are run in the order of the page, as if they were
typed into one shell; each page has a shell and a folder of its own. Neighbouring blocks of
``python`` are one program. What a page starts in the background it has to end itself. Blocks of the
language ``sh`` are not run: they need a robot, or a ROS installation.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "doc/concepts/code.md",
    *sorted((ROOT / "doc/tutorials").glob("*.md")),
]

BEGIN = "set -euo pipefail"
END = """
for _ in $(seq 100); do  # what was killed takes a moment to end
    [ -n "$(jobs -rp)" ] && sleep 0.1
done
if [ -n "$(jobs -rp)" ]; then
    echo "the page leaves processes running: $(jobs -r)" >&2
    exit 1
fi
"""
LONGEST = 1800.0  # s for one page

_FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_ALL_TESTS = re.compile(r"^.*python3 -m pytest$", re.MULTILINE)
_ENVIRONMENT = re.compile(
    r"^(scripts/in_venv \S+ |source \.venv/bin/activate$|pip install .*$)", re.MULTILINE
)


class Block(NamedTuple):
    """A block of code of a page, by its language."""

    language: str
    code: str


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page."""
    return [Block(*found) for found in _FENCE.findall(page.read_text(encoding="utf-8"))]


def script(page: Path) -> str:
    """What is typed into the shell of a page."""
    run = [block for block in blocks(page) if block.language in ("bash", "python")]
    parts = [BEGIN]
    for language, group in groupby(run, key=lambda block: block.language):
        code = "\n".join(block.code for block in group)
        is_bash = language == "bash"
        parts.append(code if is_bash else f"python3 - <<'END_OF_PROGRAM'\n{code}END_OF_PROGRAM")
    return "\n".join([*parts, END])


def run_page(page: Path, folder: Path, environment: dict[str, str], *, fresh: bool) -> None:
    """Run all programs of a page in a folder; raises `RuntimeError` if one fails."""
    code = _ALL_TESTS.sub("", script(page))
    if not fresh:
        code = _ENVIRONMENT.sub("", code)
    print(f"--- {page.relative_to(ROOT)}", flush=True)
    command = ["bash", "-c", code]
    process = subprocess.Popen(command, cwd=folder, env=environment, start_new_session=True)
    try:
        status = process.wait(LONGEST)
    finally:
        with suppress(ProcessLookupError):  # nothing of the page is left
            os.killpg(process.pid, signal.SIGKILL)
    if status:
        raise RuntimeError(f"{page.name} ended with status {status}:\n{code}")


def this_environment(folder: Path) -> dict[str, str]:
    """Environment variables with which this Python runs the code of this checkout."""
    scripts = folder / "bin"
    scripts.mkdir()
    for name, arguments in (("python3", ""), ("mp-pca", "-m mp_pca_planner ")):
        text = f'#!/bin/sh\nexec "{sys.executable}" {arguments}"$@"\n'
        (scripts / name).write_text(text, encoding="utf-8")
        (scripts / name).chmod(0o755)
    paths = {"PATH": str(scripts), "PYTHONPATH": str(ROOT)}
    return {name: os.pathsep.join([path, os.environ.get(name, "")]) for name, path in paths.items()}


def checkout(folder: Path, *, fresh: bool) -> Path:
    """A clone of this checkout, or as much of it as the README uses."""
    copy = folder / "mp_pca_planner"
    if fresh:
        subprocess.run(["git", "clone", "--quiet", ROOT, copy], check=True)
    else:
        shutil.copytree(ROOT / "config", copy / "config")
    return copy


def main() -> None:
    """Run the pages that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path, default=PAGES)
    parser.add_argument("--fresh", action="store_true", help="in a clone, with a new environment")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = os.environ | {"MPLBACKEND": "Agg"}
        # Pages that run at the same time, here or on other computers, do not hear each other.
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        environment.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 101))
        clone = checkout(folder, fresh=arguments.fresh)
        if arguments.fresh:
            # As the README's first command makes it. Its example in Python stands before that.
            subprocess.run([clone / "scripts/in_venv", "plot", "true"], check=True)
            environment["PATH"] = f"{clone / '.venv/bin'}{os.pathsep}{environment['PATH']}"
        else:
            environment |= this_environment(folder)
        for page in arguments.pages:
            own = clone if page.name == "README.md" else folder / page.stem
            own.mkdir(exist_ok=True)
            run_page(page.resolve(), own, environment, fresh=arguments.fresh)


if __name__ == "__main__":
    main()
