# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What commands print: one line for each error, and foreign text that stays on its line."""

import contextlib
import errno
import io
import os
import subprocess
import sys
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest
from support.bags import reaching, stamped, write_bag

import mp_pca_planner.cli.main as program
from mp_pca_planner.exceptions import PlannerError, printable

HOSTILE = "\x1b]0;owned\x07\nroot# \u202ecba\udcff"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Schulter_関節 ½∫‖τ‖²dt → 5°, ρ̂", "Schulter_関節 ½∫‖τ‖²dt → 5°, ρ̂"),
        ("a\nb\r\tc", r"a\nb\r\tc"),
        ("\x1b]0;title\x07\x9b31m", r"\x1b]0;title\x07\x9b31m"),
        ("\u202egnp.exe\u2066\u200b", r"\u202egnp.exe\u2066\u200b"),
    ],
)
def test_printable_escapes_what_moves_the_cursor_or_the_text(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_printable_leaves_no_control_format_or_surrogate_character() -> None:
    shown = printable("".join(map(chr, range(0x110000))))
    assert not {unicodedata.category(c) for c in shown} & {"Cc", "Cf", "Cs", "Zl", "Zp"}
    shown.encode()


# Errors


def failing(error: BaseException) -> Callable[[str, list[str]], NoReturn]:
    """A command that raises an error."""

    def command(name: str, argv: list[str]) -> NoReturn:
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (PlannerError("no such thing"), 2, "plan: no such thing"),
        (ValueError("shapes\ndiffer"), 1, r"unexpected ValueError: shapes\ndiffer"),
        (MemoryError("9 GiB"), 1, "unexpected MemoryError: 9 GiB (repeat"),
        (
            PermissionError(errno.EACCES, "Permission denied", "x.yaml"),
            1,
            "denied: 'x.yaml'",
        ),
        (KeyboardInterrupt(), 1, "plan: interrupted"),
    ],
)
def test_every_error_is_one_line_and_debug_adds_its_traceback(
    error: BaseException,
    status: int,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(program, "run_command", failing(error))
    assert program.main(["plan"]) == status
    usual = capsys.readouterr()
    assert usual.out == "" and usual.err.count("\n") == 1 and words in usual.err
    assert program.main(["plan", "--debug"]) == status
    debugged = capsys.readouterr().err
    assert debugged.startswith("Traceback") and debugged.endswith(usual.err)


@pytest.mark.parametrize("arguments", [["plan", "--help"], ["--help"]])
def test_a_reader_that_has_seen_enough_is_no_error(arguments: list[str], tmp_path: Path) -> None:
    # The pipe has no reader from the start, so nothing depends on who is faster. Unbuffered output
    # would fail elsewhere.
    reading, writing = os.pipe()
    os.close(reading)
    buffered = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    with open(writing, "wb") as pipe:
        done = subprocess.run(
            [sys.executable, "-m", "mp_pca_planner", *arguments],
            stdout=pipe,
            stderr=subprocess.PIPE,
            cwd=tmp_path,
            env=buffered,
            check=False,
        )
    assert done.stderr == b""
    assert done.returncode in (0, 1)


# Foreign text


def printed(*arguments: str | Path, status: int) -> str:
    """What a command prints on both streams."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            found = program.main([str(argument) for argument in arguments])
        except SystemExit as ending:
            found = ending.code
    assert found == status, out.getvalue()
    return out.getvalue()


def assert_harmless(text: str) -> None:
    assert all(line.isprintable() for line in text.split("\n"))
    assert not any(line.startswith("root#") for line in text.split("\n"))


def test_names_from_a_bag_do_not_steer_the_terminal(tmp_path: Path) -> None:
    name = HOSTILE.replace("\udcff", "")  # messages hold UTF-8
    bag, file = tmp_path / "bag", tmp_path / "reach.npz"
    write_bag(bag, "mcap", stamped(reaching([0.0, 1.0, 0.2, 0.9]), names=(name, "b")))
    texts = [
        printed("inspect", bag, status=0),
        printed("build_primitives", bag, "--output", file, "--coupling", "joint", status=0),
        printed("inspect", file, status=0),
        printed("inspect", bag, "--topic", HOSTILE, status=2),
        printed("plan", "--robot", HOSTILE, file, "--start", "0", "--goal", "0", status=2),
        printed("inspect", file, f"--{HOSTILE}", status=2),
        printed(HOSTILE, status=2),
    ]
    for text in texts:
        assert_harmless(text)
        assert "root#" in text


def test_joints_called_as_mathematics_are_drawn_as_they_are_called(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    bag, page = tmp_path / "bag", tmp_path / "page.html"
    write_bag(bag, "mcap", stamped(reaching([0.0, 1.0, 0.2]), names=("$$", r"$\frac$")))
    output = ("--output", tmp_path / "reach.npz", "--name", "$x")
    printed("build_primitives", bag, *output, "--report", page, status=0)
    assert "data:image/png" in page.read_text()


# Hints
