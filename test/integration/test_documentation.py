# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The README and the pages of ``doc/``: their programs, commands, links and the reference."""

import ast
import json
import re
import runpy
import shlex
import subprocess
import sys
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from support.patience import HANG

import mp_pca_planner
from mp_pca_planner.cli.main import COMMANDS, add_options, parse
from mp_pca_planner.execution.parameters import DECLARATIONS
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.primitives.file import _METADATA
from mp_pca_planner.primitives.library import _LINE
from mp_pca_planner.primitives.primitive_values import ARRAY_SHAPES
from mp_pca_planner.recordings.cutting import COLUMNS
from mp_pca_planner.simulation.robot import Record

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts/run_documentation.py"
DOCUMENTATION = runpy.run_path(str(SCRIPT))
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "doc").rglob("*.md")])
PAGES = [page for page in PAGES if "reference" not in page.parts]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
# Their sentences are short.
READ_FIRST = [*DOCUMENTATION["PAGES"], ROOT / "doc/index.md", *(ROOT / "doc/guides").glob("*.md")]
READ_FIRST += [ROOT / f"doc/{name}.md" for name in ("install", "troubleshooting", "limits")]
READ_FIRST += [ROOT / f"doc/concepts/{name}.md" for name in ("method", "glossary")]
MADE_BY_SPHINX = (ROOT / "doc/reference", ROOT / "doc/gallery")

# Stands for something in a command that is shown: the options of it are checked one by one.
ELLIPSIS = "…"


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


# Programs


@pytest.mark.parametrize(
    "page", DOCUMENTATION["PAGES"], ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_programs_of_the_page_run(page: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    if "mp-pca example panda" in DOCUMENTATION["script"](page):
        pytest.importorskip("example_robot_data", reason="extra 'example' is not installed")
    if "planner_node" in DOCUMENTATION["script"](page):
        pytest.importorskip("rclpy", reason="rclpy (extra 'ros') is not installed")
    done = subprocess.run(
        [sys.executable, SCRIPT, page], capture_output=True, text=True, timeout=HANG, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("--- ") == 1


def test_a_page_that_leaves_processes_running_fails(tmp_path: Path) -> None:
    for block, is_clean in (("sleep 15 &\n", False), ("sleep 15 &\nkill %1\nwait\n", True)):
        text = tmp_path / "page.md"
        text.write_text(f"```bash\n{block}```\n\n```bash\ntrue\n```\n", encoding="utf-8")
        command = ["bash", "-c", DOCUMENTATION["script"](text)]
        done = subprocess.run(command, capture_output=True, check=False, timeout=HANG)
        assert (done.returncode == 0) == is_clean, done.stderr


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
            parse(command, ["--help-all"])
        known = capsys.readouterr().out
        assert all(f"{word} " in known for word in words if word.startswith("--"))


def test_every_command_is_described_somewhere() -> None:
    described = {command for page in PAGES for command, *_ in commands_of(page)}
    assert set(COMMANDS) <= described


# Links


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as GitHub and MyST make them."""
    headings = re.findall(r"^#+ (.*)$", text_of(page), re.MULTILINE)
    words = (re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings)
    return set(words)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_to_files_and_headings_that_exist(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", text_of(page)):
        assert not link.startswith("http"), "pages outside of the project may vanish"
        if link.startswith("../../actions/"):  # GitHub's own picture of the last run
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists() or target.parent in MADE_BY_SPHINX, link
        assert not anchor or anchor in anchors(target), link


def test_every_page_is_in_the_site() -> None:
    linked = set()
    index = ROOT / "doc/index.md"
    for names in re.findall(r"^```{toctree}\n(.*?)^```", text_of(index), re.MULTILINE | re.DOTALL):
        linked |= {name for name in names.split() if not name.startswith(":")}
    pages = {
        page.relative_to(ROOT / "doc").with_suffix("").as_posix()
        for page in PAGES
        if ROOT / "doc" in page.parents
    }
    assert pages - {"index"} <= linked


# Names


def test_every_topic_and_service_of_the_node_is_described() -> None:
    policy = text_of(ROOT / "config/sros2_policy.xml")
    names = set(re.findall(r"<(?:topic|service)>(~/\w+)</", policy))
    # Services that every node has.
    own = {name for name in names if "_parameter" not in name} - {"~/get_type_description"}
    guide = text_of(ROOT / "doc/guides/node.md")
    assert own
    assert {name for name in own if f"`{name}`" not in guide} == set()


def messages_of_the_code() -> str:
    """All texts in the sources; what is inserted into them is left out."""
    texts = [(ROOT / "scripts/in_venv").read_text(encoding="utf-8").replace('"\n', " ")]
    for source in sorted((ROOT / "mp_pca_planner").rglob("*.py")):
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [part.value for part in node.values if isinstance(part, ast.Constant)]
                texts.append("".join(map(str, parts)))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return "\n".join(texts)


def test_messages_that_are_explained_are_those_of_the_code() -> None:
    page = text_of(ROOT / "doc/troubleshooting.md")
    explained = re.findall(r'^### "(.*)"$', page, re.MULTILINE)
    code = messages_of_the_code()
    assert len(explained) > 10
    assert [message for message in explained if message not in code] == []


def test_the_page_on_the_code_names_what_is_there() -> None:
    package = ROOT / "mp_pca_planner"
    modules = [path.relative_to(ROOT).as_posix() for path in package.rglob("*")]
    code = "\n".join(path.read_text(encoding="utf-8") for path in package.rglob("*.py"))
    words = set(re.findall(r"\w+", code))
    text = text_of(ROOT / "doc/concepts/code.md")
    for name in re.findall(r"`([^`]+)`", text) + re.findall(r"[\w/]+\.py", text):
        if name.endswith(("/", ".py")):
            path = "/" + name.strip("./")
            assert any(x.endswith(path) for x in modules), name
        else:
            assert set(re.findall(r"\w+", name)) <= words, name


def test_citation_is_complete() -> None:
    citation = yaml.safe_load(text_of(ROOT / "CITATION.cff"))
    assert {"cff-version", "message", "title", "authors", "version", "license"} <= set(citation)


def test_readme_is_short() -> None:
    assert len(text_of(ROOT / "README.md").splitlines()) <= 150


def words_per_sentence(page: Path) -> list[int]:
    """Words of each sentence of the prose: no code, tables, headings or images."""
    text = re.sub(r"^```.*?^```$", "", text_of(page), flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"^(?: {4}|\||#|<!--|\[?!\[).*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)  # a link counts as its words
    text = re.sub(r"`[^`]*`", "code", text)
    sentences = [
        sentence
        for paragraph in re.split(r"\n\s*\n|\n(?=[-*] |\d+\. )", text)
        for sentence in re.split(r"(?<=[.!?:])\s", " ".join(paragraph.split()))
    ]
    return [n for n in (len(re.findall(r"\w[^\s]*", sentence)) for sentence in sentences) if n > 1]


@pytest.mark.parametrize("page", READ_FIRST, ids=lambda page: page.name)
def test_sentences_of_pages_that_are_read_first_are_short(page: Path) -> None:
    lengths = words_per_sentence(page)
    assert np.mean(lengths) <= 16
    assert max(lengths) <= 30


@pytest.fixture(scope="module")
def reference() -> dict[str, Any]:
    """The functions that write the pages of the reference."""
    return runpy.run_path(str(ROOT / "doc/reference.py"))


def test_reference_has_every_command_with_every_option(
    reference: dict[str, Any],
) -> None:
    page = reference["commands_page"]()
    sections = dict(re.findall(r"^## (\w+)\n\n(.*?)(?=\n## |\Z)", page, re.MULTILINE | re.DOTALL))
    assert set(sections) == set(COMMANDS)
    for command, text in sections.items():
        parser = ArgumentParser()
        add_options(parser, command)
        names = {name for action in parser._actions for name in action.option_strings}
        assert [name for name in names if not re.search(rf"{name}\b", text)] == []
        meanings = re.findall(r"^`(-[^`]+)`\n: \S", text, re.MULTILINE)
        stated = {name for one in meanings for name in re.findall(r"(?<!\w)-[\w-]+", one)}
        assert names - {"-h"} <= stated


def test_reference_has_every_parameter_and_every_public_name(reference: dict[str, Any]) -> None:
    parameters, python = (
        reference["parameters_page"](),
        "".join(reference["python_pages"]().values()),
    )
    assert [d.name for d in DECLARATIONS if f"`{d.name}`" not in parameters] == []
    assert [name for name in mp_pca_planner.__all__ if f"\n## {name}\n" not in python] == []


def test_file_formats_name_all_that_is_in_the_files() -> None:
    zero = np.zeros((2, 1))
    motion = Trajectory(["a"], [0.0, 1.0], zero, zero, zero, zero)
    names = {*ARRAY_SHAPES, *_METADATA, *motion.columns(), *_LINE, *Record(1).arrays()}
    page = text_of(ROOT / "doc/formats.md")
    assert ",".join(COLUMNS) in page
    assert [name for name in names if f"`{name.rstrip('?')}`" not in page] == ["refined_from?"]


def test_recorded_results_state_their_origin_and_become_tables(reference: dict[str, Any]) -> None:
    page = reference["results_page"]()
    records = sorted((ROOT / "doc/results").glob("*.json"))
    assert records
    for file in records:
        record = json.loads(text_of(file))
        for fact in ("command", "date", "commit", "machine"):
            assert record[fact] in page
        for title, table in record["tables"].items():
            assert f"### {title}" in page
            assert all(len(row) == len(table["header"]) for row in table["rows"])


def test_tables_of_benchmarks_have_a_command_and_are_those_recorded(
    reference: dict[str, Any],
) -> None:
    page = text_of(ROOT / "doc/benchmarks.md")
    assert reference["with_results"](page) == page
    commands = runpy.run_path(str(ROOT / "scripts/record_results.py"))["COMMANDS"]
    marked = re.findall(r"<!-- table (\w+)", page)
    assert len(marked) > 10 and set(marked) <= set(commands)
    assert {file.stem for file in (ROOT / "doc/results").glob("*.json")} <= set(commands)
    outside = re.sub(r"<!-- table .*?<!-- end -->", "", page, flags=re.DOTALL)
    assert not re.search(r"^\|", outside, re.MULTILINE)


def test_commands_of_benchmarks_are_accepted() -> None:
    for command in runpy.run_path(str(ROOT / "scripts/record_results.py"))["COMMANDS"].values():
        python, *words = shlex.split(command)
        assert python == "python3"
        if words[0] == "-m":
            parse(words[2], [*words[3:], "--json"])
            continue
        source = text_of(ROOT / words[0])
        assert "benchmark_parser(__doc__)" in source
        assert all(f'"{word}"' in source for word in words if word.startswith("--"))
