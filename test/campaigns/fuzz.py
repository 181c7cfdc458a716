# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Fuzz test of the commands that read files, with corrupted files of every format.

    python3 -m campaigns.fuzz [--inputs 20000] [--formats npz,mcap] [--seed 0] [--jobs 2]
    python3 -m campaigns.fuzz --formats mcap --only 17      # one input, with its traceback

Each input is a valid file that is corrupted at random (`fuzz_files`); its number is the seed. A
command may succeed or reject the input: it exits with 0, 1 or 2 and prints one line of error. It
fails the test if it raises, crashes, computes for more than 5 s, takes more than 1 GB, prints
control characters, or writes outside of its output folder. The script exits with 1 on any failure.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import yaml
from campaigns.fuzz_files import (
    GOAL,
    START,
    Spoil,
    make_seeds,
    spoil_bag,
    spoil_npz,
    spoil_text,
    spoil_yaml,
)

from mp_pca_planner.cli.main import main as command

CPU_SECONDS, MEMORY = 5.0, 1 << 30
SILENCE = 60.0  # a process without output for this time counts as hung [s]
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
UNEXPECTED = ("internal error", "not enough memory")
WRITES = {"os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate"}
MOTION = ["--robot", "{seeds}/a.urdf", f"--start={START}", f"--goal={GOAL}"]
PLAN = ["plan", "{seeds}/a.npz", *MOTION, "--output", "{out}/plan.csv", "--force"]
BUILD = ["build_primitives", "--output", "{out}/built.npz", "--force"]


@dataclass(frozen=True)
class Format:
    """A format of files.

    Attributes
    ----------
    seed : str
        The valid file, or the folder that holds it.
    spoil : callable
        Corrupts the file.
    commands : tuple of list of str
        The commands that read the file; `{file}` stands for its path.
    inside : str
        The file to corrupt in a folder.
    """

    seed: str
    spoil: Spoil
    commands: tuple[list[str], ...]
    inside: str = ""


BAG = (["inspect", "{file}"], ["inspect", "--recover", "{file}"], [*BUILD, "{file}"])
FORMATS = {
    "npz": Format(
        "a.npz",
        spoil_npz,
        (
            ["inspect", "{file}"],
            ["plan", "{file}", *MOTION],
        ),
    ),
    "mcap": Format("a.mcap", spoil_bag, BAG),
    "db3": Format("a.db3", spoil_bag, BAG),
    "bag": Format("a.bag", spoil_bag, BAG),
    "metadata": Format("folder", spoil_yaml, BAG, "metadata.yaml"),
    "urdf": Format("a.urdf", spoil_text, ([*PLAN, "--robot", "{file}", "--collision"],)),
    "srdf": Format("a.srdf", spoil_text, ([*PLAN, "--collision", "--srdf", "{file}"],)),
    "limits": Format("limits.yaml", spoil_yaml, ([*PLAN, "--limits", "{file}"],)),
    "markers": Format(
        "markers.yaml",
        spoil_yaml,
        (
            [
                *(*BUILD, "{seeds}/markers", "--robot", "{seeds}/a.urdf", "--markers", "/tf"),
                *("--marker-map", "{file}"),
            ],
        ),
    ),
    "segments": Format("a.csv", spoil_text, ([*BUILD, "{seeds}/a.mcap", "--segments", "{file}"],)),
    "scene": Format("scene.yaml", spoil_yaml, ([*PLAN, "--obstacles", "{file}"],)),
    "scene_text": Format("a.scene", spoil_text, ([*PLAN, "--obstacles", "{file}"],)),
}


class TooLong(BaseException):
    """An input exceeded its computing time."""


def try_input(name: str, number: int, seed: int, seeds: Path, work: Path, *more: str) -> list[str]:
    """Corrupt one file and run a command on it; return the failures and the exit status."""
    random = np.random.default_rng([seed, list(FORMATS).index(name), number])
    one, (inputs, out) = FORMATS[name], (work / "in", work / "out")
    for folder in (inputs, out):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    file = inputs / one.seed
    (shutil.copytree if (seeds / one.seed).is_dir() else shutil.copy)(seeds / one.seed, file)
    # Some formats can't represent some values.
    while not _is_spoilt(one.spoil, file / one.inside if one.inside else file, random):
        pass
    chosen = one.commands[int(random.integers(0, len(one.commands)))]
    arguments = [part.format(file=file, out=out, seeds=seeds) for part in chosen]
    return judged([*arguments, *more], allowed=(out, Path(tempfile.gettempdir())))


def _is_spoilt(spoil: Spoil, file: Path, random: np.random.Generator) -> bool:
    content = file.read_bytes()
    try:
        spoil(file, random)
    except (struct.error, ValueError, OverflowError, RecursionError, yaml.YAMLError):
        file.write_bytes(content)
        return False
    return True


def judged(arguments: Sequence[str], allowed: tuple[Path, ...]) -> list[str]:
    """Run a command; return its failures, with the exit status as the last entry."""
    problems, printed = [], io.StringIO()
    signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)
    try:
        with (
            contextlib.redirect_stdout(printed),
            contextlib.redirect_stderr(printed),
            watched_writes(allowed) as written,
        ):
            status: Any = command(arguments)
    except SystemExit as end:
        status = end.code
    except TooLong:
        status = f"computed for over {CPU_SECONDS} s"
    except BaseException as error:
        status = "raised " + "".join(traceback.format_exception(error)[-3:])
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    if status not in (0, 1, 2):
        problems.append(str(status))
    problems += [f"wrote {path}" for path in written]
    odd = CONTROL.search(printed.getvalue())
    if odd or any(word in printed.getvalue() for word in UNEXPECTED):
        problems.append(f"printed {printed.getvalue()[-3000:]!r}")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    if memory > MEMORY:
        problems.append(f"took {memory / 1e9:.2g} GB")
    return [*problems, str(status)]


def _stop(_signal: int, _frame: FrameType | None) -> None:
    raise TooLong


_watch: tuple[tuple[Path, ...], list[str]] | None = None


@contextlib.contextmanager
def watched_writes(allowed: tuple[Path, ...]) -> Iterator[list[str]]:
    """Collect the paths outside of some folders that Python writes inside the block."""
    global _watch
    found: list[str] = []
    _watch = tuple(path.resolve() for path in allowed), found
    try:
        yield found
    finally:
        _watch = None


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if _watch is None:
        return
    if event == "open":
        path, mode, flags = arguments
        if not isinstance(path, str | bytes | os.PathLike):
            return
        if not (set(mode or "") & set("wax+") or flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)):
            return
        paths = [path]
    elif event in WRITES:
        paths = [part for part in arguments[:2] if isinstance(part, str | bytes | os.PathLike)]
    else:
        return
    folders, found = _watch
    for path in paths:
        real = Path(os.fsdecode(path)).absolute()
        if str(real) != "/dev/null" and not any(real.is_relative_to(f) for f in folders):
            found.append(f"{event} {real}")


def check_seeds(seeds: Path, work: Path) -> None:
    """Raise an error if a valid file is rejected: corrupted ones would then test nothing."""
    for name, one in FORMATS.items():
        for command_line in one.commands:
            shutil.rmtree(work, ignore_errors=True)
            work.mkdir()
            arguments = [
                p.format(file=seeds / one.seed, out=work, seeds=seeds) for p in command_line
            ]
            *_, status = judged(arguments, allowed=(work, seeds))
            if status != "0":
                raise SystemExit(f"a valid {name} ends with {status}: {' '.join(arguments)}")


def work_on(jobs: Connection, seeds: Path, folder: Path, seed: int) -> None:
    """Test the received inputs in a separate process."""
    temporary = folder / "tmp"
    temporary.mkdir(parents=True, exist_ok=True)
    tempfile.tempdir = str(temporary)
    os.chdir(folder)
    sys.addaudithook(_audit)
    # Output of libraries that bypasses Python's streams.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    while (job := jobs.recv()) is not None:
        jobs.send(try_input(*job, seed, seeds, folder))


def main() -> int:
    """Test all inputs; print the failures and a row per format."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=20000)
    parser.add_argument("--formats", default=",".join(FORMATS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--only", type=int, help="number of the only input, whose file is kept")
    arguments = parser.parse_args()
    names = arguments.formats.split(",")
    with tempfile.TemporaryDirectory() as temporary:
        seeds = Path(temporary, "seeds")
        seeds.mkdir()
        with contextlib.redirect_stdout(io.StringIO()):
            make_seeds(seeds)
            check_seeds(seeds, Path(temporary, "check"))
        if arguments.only is not None:
            sys.addaudithook(_audit)
            work = Path(tempfile.mkdtemp(dir=tempfile.gettempdir()))
            number = arguments.only
            for problem in try_input(names[0], number, arguments.seed, seeds, work, "--debug"):
                print(problem.replace("\\n", "\n"))
            print(f"its files are in {work}")
            return 0
        numbers = [(names[k % len(names)], k // len(names)) for k in range(arguments.inputs)]
        return _report(numbers, Path(temporary), arguments.seed, arguments.jobs)


def _report(numbers: list[tuple[str, int]], folder: Path, seed: int, n_jobs: int) -> int:
    n_bad, ends = 0, Counter[tuple[str, str]]()
    for (name, number), (*problems, end) in results(numbers, folder, seed, n_jobs):
        ends[name, end if end in ("0", "1", "2") else "bad"] += 1
        n_bad += bool(problems)
        for problem in problems:
            print(f"--formats {name} --only {number}: {problem}", file=sys.stderr, flush=True)
    columns = ("0", "1", "2", "bad")
    print(json.dumps({n: {c: ends[n, c] for c in columns} for n in dict.fromkeys(FORMATS)}))
    print(f"{len(numbers)} inputs, {n_bad} with problems")
    return int(n_bad > 0)


def results(
    numbers: list[tuple[str, int]], folder: Path, seed: int, n_jobs: int
) -> Iterator[tuple[tuple[str, int], list[str]]]:
    """Yield the result of each input; worker processes that end or hang are replaced."""
    context, left = get_context("spawn"), iter(numbers)
    busy: dict[Connection, tuple[Any, tuple[str, int]]] = {}

    def start(k: int) -> tuple[Connection, Any]:
        here, there = context.Pipe()
        work = (there, folder / "seeds", folder / f"work{k}", seed)
        process = context.Process(target=work_on, args=work)
        process.start()
        there.close()
        return here, process

    idle = [start(k) for k in range(n_jobs)]
    n_started = n_jobs
    while True:
        while idle and (job := next(left, None)) is not None:
            connection, process = idle.pop()
            connection.send(job)
            busy[connection] = process, job
        if not busy:
            break
        ready = wait(list(busy), timeout=SILENCE)
        for connection in ready or list(busy):
            process, job = busy.pop(connection)  # type: ignore[index]
            try:
                outcome = connection.recv() if ready else ["hung", "bad"]  # type: ignore[union-attr]
            except EOFError:
                process.join()
                outcome = [f"ended its process ({process.exitcode})", "bad"]
            yield job, outcome
            if outcome[-1] in ("0", "1", "2") and len(outcome) == 1:
                idle.append((connection, process))  # type: ignore[arg-type]
                continue
            process.kill()
            process.join()
            idle.append(start(n_started))
            n_started += 1
    for connection, process in idle:
        connection.send(None)
        process.join()


if __name__ == "__main__":
    sys.exit(main())
