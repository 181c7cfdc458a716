# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Test of crash safety: processes are killed while they write, and earlier files stay intact.

    python3 -m campaigns.kills [--kills 200] [--seed 0]

`build_primitives --force` and `refine --force` get a SIGKILL after their first write. Then each
earlier file must hold its complete old or new content. The same command must then succeed. The
script exits with 1 otherwise.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from campaigns.fuzz_files import GOAL, START, make_seeds

from mp_pca_planner.cli.main import main as command
from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.primitives.file import load_primitive

Files = dict[str, bytes]


@dataclass(frozen=True)
class Victim:
    """A command to kill.

    Attributes
    ----------
    name : str
        Name in the output.
    arguments : callable
        Returns its command line for a folder.
    """

    name: str
    arguments: Callable[[Path], list[str]]

    def run(self, folder: Path, kill_after: float | None) -> float:
        """Run it in a fork; return the time from its first write to its end or its kill [s]."""
        reading, writing = os.pipe()
        process = os.fork()
        if process == 0:
            os._exit(_as_child(self.arguments(folder), folder, writing))
        os.close(writing)
        os.read(reading, 1)
        began = time.perf_counter()
        if kill_after is not None:
            time.sleep(kill_after)
            os.kill(process, signal.SIGKILL)
        _, status = os.waitpid(process, 0)
        os.close(reading)
        if kill_after is None and status != 0:
            raise SystemExit(f"{self.name} ended with {os.waitstatus_to_exitcode(status)}")
        return time.perf_counter() - began


def _as_child(arguments: list[str], folder: Path, writing: int) -> int:
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)

    def say_first_write(event: str, values: tuple[Any, ...]) -> None:
        nonlocal writing
        if writing >= 0 and event == "open" and isinstance(values[0], str | os.PathLike):
            is_written = values[2] & (os.O_WRONLY | os.O_RDWR)
            if is_written and Path(values[0]).is_relative_to(folder):
                os.write(writing, b"x")
                writing = -1

    sys.addaudithook(say_first_write)
    try:
        return command(arguments)
    except SystemExit as end:
        return int(end.code or 0)


def contents(folder: Path) -> Files:
    """All files below a folder, except lock files."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in ("lock", ".lock")
    }


def is_temporary(name: str) -> bool:
    """Whether a file is a leftover of a killed process."""
    return any(part.startswith(".") for part in Path(name).parts)


def differences(before: Files, found: Files, after: Files) -> list[str]:
    """Files with neither their old nor their new content."""
    problems = []
    for name, content in found.items():
        allowed = [files[name] for files in (before, after) if name in files]
        if not is_temporary(name) and content not in allowed:
            problems.append(f"'{name}' holds something else")
    return problems + [f"'{name}' is gone" for name in before if name not in found]


def _changed(before: Files, found: Files) -> list[str]:
    return [name for name in before | found if before.get(name) != found.get(name)]


def kill(victim: Victim, seeds: Path, work: Path, n: int, random: np.random.Generator) -> list[str]:
    """Kill it this many times; return the failures."""

    def anew() -> None:
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(seeds, work)

    anew()
    before = contents(work)
    takes = victim.run(work, None)
    after = contents(work)
    problems, n_changed = [], 0
    for k in range(n):
        anew()
        victim.run(work, random.uniform(0.0, 1.1 * takes))
        found = contents(work)
        n_changed += any(not is_temporary(name) for name in _changed(before, found))
        problems += [f"{victim.name}, kill {k}: {one}" for one in differences(before, found, after)]
        victim.run(work, None)
        problems += [f"{victim.name}, kill {k}: {one}" for one in unreadable(work)]
    print(
        f"{victim.name:20} {n} kills, {n_changed} of them after a file had changed; "
        f"it writes for {1e3 * takes:.0f} ms; {len(problems)} problems"
    )
    return problems


def unreadable(folder: Path) -> list[str]:
    """Errors of primitive files below a folder."""
    problems = []
    for file in folder.glob("**/*.npz"):
        if not is_temporary(str(file.relative_to(folder))):
            try:
                load_primitive(file)
            except PlannerError as error:
                problems.append(str(error))
    return problems


def build(folder: Path) -> list[str]:
    """A primitive over an older one."""
    bag = str(folder / "a.mcap")
    return ["build_primitives", bag, "--output", str(folder / "other.npz"), "--force"]


def refined(folder: Path) -> list[str]:
    """A refined motion over an older primitive."""
    return [
        *("refine", str(folder / "a.npz"), "--robot", str(folder / "human_arm.urdf")),
        *(f"--start={START}", f"--goal={GOAL}", "--output", str(folder / "other.npz"), "--force"),
    ]


def main() -> int:
    """Run all kills and print a line per command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    random = np.random.default_rng(arguments.seed)
    problems = []
    with tempfile.TemporaryDirectory() as temporary:
        seeds, work = Path(temporary, "seeds"), Path(temporary, "work")
        seeds.mkdir()
        make_seeds(seeds)
        build_other = ["build_primitives", str(seeds / "a.mcap"), "--components", "1"]
        command([*build_other, "--output", str(seeds / "other.npz")])
        victims = [Victim("build_primitives", build), Victim("refine", refined)]
        for victim in victims:
            problems += kill(victim, seeds, work, arguments.kills // len(victims), random)
    for problem in problems:
        print(problem, file=sys.stderr)
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
