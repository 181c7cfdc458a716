# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Commands that are killed while they write: earlier files stay whole.

    python3 -m campaigns.kills [--kills 200] [--seed 0]

`build_primitives --force` and `refine --force` get a SIGKILL after their first write. Each earlier
file then holds its complete old or new content, and the same command succeeds. The script exits
with 1 otherwise.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from campaigns.fuzz_files import GOAL, START, make_seeds
from support.tables import options

from mp_pca_planner.cli.main import main as command
from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.primitives.file import load_primitive

Files = dict[str, bytes]

WRITERS = {
    "build_primitives": ["build_primitives", "{0}/a.mcap", "--output", "{0}/other.npz", "--force"],
    "refine": [
        *("refine", "{0}/a.npz", "--robot", "{0}/human_arm.urdf", f"--start={START}"),
        *(f"--goal={GOAL}", "--output", "{0}/other.npz", "--force"),
    ],
}


def main() -> int:
    """Kill each command many times; print a line for it, and its problems."""
    arguments = options(__doc__, kills=200, seed=0)
    random, problems = np.random.default_rng(arguments.seed), list[str]()
    with tempfile.TemporaryDirectory() as temporary:
        seeds, work = Path(temporary, "seeds"), Path(temporary, "work")
        seeds.mkdir()
        make_seeds(seeds)
        build_other = ["build_primitives", str(seeds / "a.mcap"), "--components", "1"]
        command([*build_other, "--output", str(seeds / "other.npz")])
        before = contents(seeds)
        for name, parts in WRITERS.items():
            words, n_changed, found = [part.format(work) for part in parts], 0, list[str]()
            shutil.copytree(seeds, work)
            takes, after = _run(words, work, None), contents(work)
            for _ in range(arguments.kills // len(WRITERS)):
                shutil.rmtree(work)
                shutil.copytree(seeds, work)
                _run(words, work, random.uniform(0.0, 1.1 * takes))
                left = contents(work)
                n_changed += left != before
                found += differences(before, left, after)
                _run(words, work, None)
                found += unreadable(work)
            shutil.rmtree(work)
            print(f"{name:17} {n_changed} times after a file had changed; {len(found)} problems")
            problems += [f"{name}: {one}" for one in found]
    print(*problems, sep="\n", file=sys.stderr)
    return int(bool(problems))


def _run(words: list[str], folder: Path, kill_after: float | None) -> float:
    """Run a command in a fork; the time from its first write to its end or its kill [s]."""
    reading, writing = os.pipe()
    if (process := os.fork()) == 0:
        os._exit(_as_child(words, folder, writing))
    os.close(writing)
    os.read(reading, 1)
    began = time.perf_counter()
    if kill_after is not None:
        time.sleep(kill_after)
        os.kill(process, signal.SIGKILL)
    _, status = os.waitpid(process, 0)
    os.close(reading)
    if kill_after is None and status != 0:
        raise SystemExit(f"{words[0]} ended with {os.waitstatus_to_exitcode(status)}")
    return time.perf_counter() - began


def _as_child(words: list[str], folder: Path, writing: int) -> int:
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
        return command(words)
    except SystemExit as end:
        return int(end.code or 0)


def contents(folder: Path) -> Files:
    """All files below a folder, except those that a killed process leaves for a moment."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
        and path.name != "lock"
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }


def differences(before: Files, found: Files, after: Files) -> list[str]:
    """Files with neither their old nor their new content."""
    whole = {(name, content) for one in (before, after) for name, content in one.items()}
    odd = [f"'{name}' holds something else" for name in found if (name, found[name]) not in whole]
    return odd + [f"'{name}' is gone" for name in before if name not in found]


def unreadable(folder: Path) -> list[str]:
    """Errors of primitive files below a folder."""
    problems = []
    for name in contents(folder):
        if name.endswith(".npz"):
            try:
                load_primitive(folder / name)
            except PlannerError as error:
                problems.append(str(error))
    return problems


if __name__ == "__main__":
    sys.exit(main())
