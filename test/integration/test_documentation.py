# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The README and the pages of ``doc/``: their programs, commands, links and the reference."""

import json
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from support.domains import lease_domain
from support.patience import HANG

import mp_pca_planner
from mp_pca_planner.cli.main import COMMANDS, main, parse
from mp_pca_planner.execution.parameters import DECLARATIONS
from mp_pca_planner.recordings.synthetic import generate_motions

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts/run_documentation.py"
DOCUMENTATION = runpy.run_path(str(SCRIPT))
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "doc").rglob("*.md")])
PAGES = [page for page in PAGES if "reference" not in page.parts]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]

CODE_PAGE = ROOT / "doc/concepts/code.md"

# Stands for something in a command that is shown: the options of it are checked one by one.
ELLIPSIS = "…"


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


# Programs


FIRST_PAGE = "first_motion.md"
"""Its programs run whenever tests do; those of the others take longer."""


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(
            page,
            id=page.relative_to(ROOT).as_posix(),
            marks=() if page.name == FIRST_PAGE else pytest.mark.slow,
        )
        for page in DOCUMENTATION["PAGES"]
    ],
)
def test_programs_of_the_page_run(page: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    if "mp-pca demo panda" in DOCUMENTATION["script"](page):
        pytest.importorskip("example_robot_data", reason="extra 'example' is not installed")
    if "planner_node" in DOCUMENTATION["script"](page):
        pytest.importorskip("rclpy", reason="rclpy (extra 'ros') is not installed")
    done = subprocess.run(
        [sys.executable, SCRIPT, page],
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
        env={**os.environ, "ROS_DOMAIN_ID": str(lease_domain("documentation"))},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("--- ") == 1


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_python_of_the_page_is_python(page: Path) -> None:
    for block in DOCUMENTATION["blocks"](page):
        if block.language == "python":
            compile(block.code, str(page), "exec")


# Commands


def commands_of(page: Path) -> list[list[str]]:
    """Calls of this package's commands in blocks of code: the words after the program."""
    text = text_of(page)
    indented = re.findall(r"(?:^    .*\n)+", text, re.MULTILINE)
    fenced = [block.code for block in DOCUMENTATION["blocks"](page) if block.language != "python"]
    lines = "\n".join([*indented, *fenced]).replace("\\\n", " ").splitlines()
    program = re.compile(r"(?:mp-pca|ros2 run mp_pca_planner|python3 -m mp_pca_planner) (.*)")
    found = (program.search(line) for line in lines)
    return [shlex.split(match[1].rstrip("& "), comments=True) for match in found if match]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_of_the_page_are_accepted(
    page: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    for command, *words in commands_of(page):
        if command in ("COMMAND", "--help", "planner_node"):
            continue
        assert command in COMMANDS
        if ELLIPSIS not in words:
            parse(command, words)  # exits if it is not accepted
            continue
        with pytest.raises(SystemExit):
            parse(command, ["--help"])
        known = capsys.readouterr().out
        assert all(f"{word} " in known for word in words if word.startswith("--"))


# Names


def test_the_command_on_the_page_of_the_code_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = (block.code for block in DOCUMENTATION["blocks"](CODE_PAGE) if block.language == "py")
    module = ModuleType("mp_pca_planner.cli.times")
    exec(compile(code, str(CODE_PAGE), "exec"), module.__dict__)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(COMMANDS, "times", "print how long demonstrations last")
    motions = generate_motions(5, seed=1)
    file = tmp_path / "p.npz"
    mp_pca_planner.MovementPrimitive.fit(motions).save(file)
    durations = sorted(motion.duration for motion in motions)
    assert main(["times", str(file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [found["shortest"], found["longest"]] == pytest.approx([durations[0], durations[-1]])
    assert main(["times", str(tmp_path / "nothere.npz")]) == 2


def test_reference_has_every_command_parameter_and_name_and_the_recorded_tables() -> None:
    reference = runpy.run_path(str(ROOT / "doc/reference.py"))
    commands, python = reference["commands_page"](), "".join(reference["python_pages"]().values())
    sections = dict(re.findall(r"^## (\w+)\n\n(.*?)(?=\n## |\Z)", commands, re.M | re.DOTALL))
    assert set(sections) == set(COMMANDS)
    for text in sections.values():
        names = set(re.findall(r"^`(-[^`]+)`", text.partition("```\n")[2], re.MULTILINE))
        assert names and names <= set(re.findall(r"^`(-[^`]+)`\n: \S", text, re.MULTILINE))
    parameters = reference["parameters_page"]()
    assert [d.name for d in DECLARATIONS if f"`{d.name}`" not in parameters] == []
    assert [name for name in mp_pca_planner.__all__ if f"\n## {name}\n" not in python] == []
    page = text_of(ROOT / "doc/benchmarks.md")
    assert reference["with_results"](page) == page
    recorded = runpy.run_path(str(ROOT / "scripts/record_results.py"))["COMMANDS"]
    assert {file.stem for file in (ROOT / "doc/results").glob("*.json")} <= set(recorded)
    assert set(re.findall(r"<!-- table (\w+)", page)) <= set(recorded)
