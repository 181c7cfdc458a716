# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Fuzz test of the commands that read files, with corrupted files of every format.

    python3 -m campaigns.fuzz [--inputs 20000] [--formats npz,mcap] [--seed 0] [--jobs 2]
    python3 -m campaigns.fuzz --formats mcap --only 17      # one input, with its traceback

Each input is a valid file that is corrupted at random (`fuzz_files`); its number is the seed. A
command may succeed or reject the input: it exits with 0, 1 or 2 and prints one line of error. It
fails the test if it raises, crashes, computes for more than 5 s, takes more than 500 MB, prints
control characters, or writes outside of its output folder. The script exits with 1 on any failure.
"""

from __future__ import annotations

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
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import yaml
from campaigns.fuzz_files import (
    GOAL,
    START,
    Spoil,
    make_seeds,
    spoil_bag,
    spoil_npz,
    spoil_parquet,
    spoil_text,
    spoil_yaml,
)
from support.tables import options

from mp_pca_planner.cli.main import main as command

CPU_SECONDS, MEGABYTES = 5, 500.0
SILENCE = 60  # a command that takes this time hangs [s]
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
UNEXPECTED = ("internal error", "not enough memory")
WRITES = {"os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate"}
NOT_SPOILT = (struct.error, ValueError, TypeError, OverflowError, RecursionError, yaml.YAMLError)
MOTION = ["--robot", "{seeds}/human_arm.urdf", f"--start={START}", f"--goal={GOAL}"]
PLAN = ["plan", "{seeds}/a.npz", *MOTION, "--output", "{out}/plan.csv", "--force"]
BUILD = ["build_primitives", "--output", "{out}/built.npz", "--force"]
MARKERS = ["{seeds}/markers", "--robot", "{seeds}/human_arm.urdf", "--markers", "/tf"]


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
TABLE = (["inspect", "{file}"], [*BUILD, "{file}"])
PRIMITIVE = (["inspect", "{file}"], ["plan", "{file}", *MOTION])
DATA = "data/chunk-000/file-000.parquet"
FORMATS = {
    "npz": Format("a.npz", spoil_npz, PRIMITIVE),
    "mcap": Format("a.mcap", spoil_bag, BAG),
    "db3": Format("a.db3", spoil_bag, BAG),
    "bag": Format("a.bag", spoil_bag, BAG),
    "metadata": Format("folder", spoil_yaml, BAG, "metadata.yaml"),
    "table": Format("table.csv", spoil_text, TABLE),
    "parquet": Format("dataset", spoil_parquet, TABLE, DATA),
    "info": Format("dataset", spoil_yaml, TABLE, "meta/info.json"),
    "urdf": Format("human_arm.urdf", spoil_text, ([*PLAN, "--robot", "{file}", "--collision"],)),
    "srdf": Format("a.srdf", spoil_text, ([*PLAN, "--collision", "--srdf", "{file}"],)),
    "limits": Format("human_arm_joint_limits.yaml", spoil_yaml, ([*PLAN, "--limits", "{file}"],)),
    "markers": Format(
        "human_arm_markers.yaml", spoil_yaml, ([*BUILD, *MARKERS, "--marker-map", "{file}"],)
    ),
    "segments": Format("a.csv", spoil_text, ([*BUILD, "{seeds}/a.mcap", "--segments", "{file}"],)),
    "scene": Format("scene.yaml", spoil_yaml, ([*PLAN, "--obstacles", "{file}"],)),
    "scene_text": Format("a.scene", spoil_text, ([*PLAN, "--obstacles", "{file}"],)),
}


def try_input(job: tuple[str, int], *more: str, seed: int, folder: Path) -> list[str]:
    """Corrupt one file and run a command on it; return the failures and the exit status."""
    (name, number), seeds, work = job, folder / "seeds", folder / f"work{os.getpid()}"
    random = np.random.default_rng([seed, list(FORMATS).index(name), number])
    one, (inputs, out) = FORMATS[name], (work / "in", work / "out")
    for made in (inputs, out):
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir(parents=True)
    file = inputs / one.seed
    (shutil.copytree if (seeds / one.seed).is_dir() else shutil.copy)(seeds / one.seed, file)
    spoilt = file / one.inside if one.inside else file
    content, is_spoilt = spoilt.read_bytes(), False
    while not is_spoilt:  # some formats can't represent some values
        with contextlib.suppress(*NOT_SPOILT, pyarrow.ArrowException):
            one.spoil(spoilt, random)
            is_spoilt = True
        if not is_spoilt:
            spoilt.write_bytes(content)
    chosen = one.commands[int(random.integers(0, len(one.commands)))]
    arguments = [part.format(file=file, out=out, seeds=seeds) for part in chosen]
    return judged([*arguments, *more], allowed=(out, Path(tempfile.gettempdir())))


def judged(arguments: Sequence[str], allowed: tuple[Path, ...]) -> list[str]:
    """Run a command in a fork; return its failures, with the exit status as the last entry."""
    reading, writing = os.pipe()
    if (child := os.fork()) == 0:
        os.close(reading)
        os.write(writing, json.dumps(_as_child(arguments, allowed)).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        content = pipe.read()
    _, status, used = os.wait4(child, 0)
    code, printed, problems = json.loads(content or '["?", "", []]')
    if status:
        code = f"ended by signal {signal.Signals(os.WTERMSIG(status)).name}"
    if code not in (0, 1, 2):
        problems.append(str(code))
    if CONTROL.search(printed) or any(word in printed for word in UNEXPECTED):
        problems.append(f"printed {printed[-3000:]!r}")
    if (megabytes := used.ru_maxrss / 1e3) > MEGABYTES:
        problems.append(f"took {megabytes:.0f} MB")
    return [*problems, str(code)]


def _as_child(arguments: Sequence[str], allowed: tuple[Path, ...]) -> tuple[Any, str, list[str]]:
    """Exit status of a command, what it printed, and what it wrote outside of some folders."""
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 1))
    signal.alarm(SILENCE)
    printed, written, folders = io.StringIO(), list[str](), [path.resolve() for path in allowed]

    def audit(event: str, values: tuple[Any, ...]) -> None:
        paths = values[:2] if event in WRITES else values[:1]
        if event == "open":
            flags = os.O_WRONLY | os.O_RDWR | os.O_CREAT
            is_written = set(values[1] or "") & set("wax+") or values[2] & flags
        else:
            is_written = event in WRITES
        for path in paths if is_written else ():
            if isinstance(path, str | bytes | os.PathLike):
                real = Path(os.fsdecode(path)).absolute()
                if str(real) != os.devnull and not any(real.is_relative_to(f) for f in folders):
                    written.append(f"wrote {event} {real}")

    # Output of libraries that bypasses Python's streams.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    sys.addaudithook(audit)
    status: Any
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            status = command(arguments)
    except SystemExit as end:
        status = end.code
    except BaseException as error:
        status = "raised " + "".join(traceback.format_exception(error)[-3:])
    return status, printed.getvalue(), list(written)


def check_seeds(seeds: Path, work: Path) -> None:
    """Raise an error if a valid file is rejected: corrupted ones would then test nothing.

    The commands run in this process, so that forks of it have all imported.
    """
    for name, one in FORMATS.items():
        for words in one.commands:
            shutil.rmtree(work, ignore_errors=True)
            work.mkdir()
            arguments = [p.format(file=seeds / one.seed, out=work, seeds=seeds) for p in words]
            if status := command(arguments):
                raise SystemExit(f"a valid {name} ends with {status}: {' '.join(arguments)}")


def _prepare(folder: Path) -> None:
    tempfile.tempdir = str(folder / f"tmp{os.getpid()}")
    Path(tempfile.tempdir).mkdir()
    os.chdir(tempfile.tempdir)


def main() -> int:
    """Test all inputs; print the failures and a row per format."""
    jobs, every = os.cpu_count() or 1, ",".join(FORMATS)
    arguments = options(__doc__, inputs=20000, formats=every, seed=0, jobs=jobs, only=-1)
    names = arguments.formats.split(",")
    folder = Path(tempfile.mkdtemp())
    (folder / "seeds").mkdir()
    with contextlib.redirect_stdout(io.StringIO()):
        make_seeds(folder / "seeds")
        check_seeds(folder / "seeds", folder / "check")
    test = partial(try_input, seed=arguments.seed, folder=folder)
    if arguments.only >= 0:
        for problem in test((names[0], arguments.only), "--debug"):
            print(problem.replace("\\n", "\n"))
        print(f"its files are in {folder}")
        return 0
    numbers = [(names[k % len(names)], k // len(names)) for k in range(arguments.inputs)]
    n_bad, ends = 0, Counter[tuple[str, str]]()
    with get_context("fork").Pool(arguments.jobs, _prepare, (folder,)) as pool:
        for (name, number), (*problems, end) in zip(numbers, pool.imap(test, numbers), strict=True):
            ends[name, end if end in ("0", "1", "2") else "bad"] += 1
            n_bad += bool(problems)
            for problem in problems:
                print(f"--formats {name} --only {number}: {problem}", file=sys.stderr, flush=True)
    shutil.rmtree(folder)
    columns = ("0", "1", "2", "bad")
    print(json.dumps({name: {c: ends[name, c] for c in columns} for name in names}))
    print(f"{len(numbers)} inputs, {n_bad} with problems")
    return int(n_bad > 0)


if __name__ == "__main__":
    sys.exit(main())
