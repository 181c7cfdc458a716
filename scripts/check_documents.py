#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Check what no test should: links, prose, metadata and the order of the rooms.

Prints one line for each finding; the exit status is 1 if there is one.
"""

from __future__ import annotations

import ast
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "mp_pca_planner"
SOURCES = sorted((ROOT / PACKAGE).rglob("*.py"))
MADE_BY_SPHINX = ROOT / "doc/reference"
PAGES = [
    page
    for page in sorted([*ROOT.glob("*.md"), *(ROOT / "doc").rglob("*.md")])
    if MADE_BY_SPHINX not in page.parents
]
# Their sentences are short, because they are read first.
READ_FIRST = [
    *(ROOT / name for name in ("README.md", "SECURITY.md", "CONTRIBUTING.md")),
    *sorted((ROOT / "doc").glob("*.md")),
    *sorted((ROOT / "doc/concepts").glob("*.md")),
    *sorted((ROOT / "doc/guides").glob("*.md")),
    *sorted((ROOT / "doc/tutorials").glob("*.md")),
]

LAYERS = [
    {"exceptions", "arrays", "files", "input_limits", "lazy", "renaming"},
    {"robot"},
    {"motion"},
    {"recordings", "mocap", "primitives"},
    {"planning"},
    {"control", "learning"},
    {"execution"},
    {"simulation", "plotting"},
    {"teaching", "view"},
    {"cli", "ros", "__main__"},
]
# Values have methods that pass them on to a later room, which is imported in the method.
HANDED_ON = {
    ("motion", "recordings"),
    ("motion", "ros"),
    ("planning", "plotting"),
    ("planning", "view"),
}
# Where rosdep calls a dependency otherwise than Python does.
ROSDEP_NAMES = {
    "coal": "pinocchio",
    "collada": "python3-collada",
    "trimesh": "python3-trimesh-pip",
    "yaml": "python3-yaml",
    **dict.fromkeys(("lz4", "backports", "compression", "rosbags"), "python3-rosbags-pip"),
    **{
        name: f"python3-{name}"
        for name in ("argcomplete", "jinja2", "matplotlib", "numpy", "scipy", "tqdm")
    },
}
# Extras that rosdep has no name for: pip brings them.
EXTRAS_ONLY = {
    *("cmaes", "distributed", "pyarrow"),
    "threadpoolctl",  # planning is slower without it
    *("rich", "viser"),
}


def main() -> int:
    """Print the findings of all checks."""
    checks = (links, site, sentences, versions, manifest, commands, rooms)
    findings = [finding for check in checks for finding in check()]
    print("\n".join([*findings, f"{len(findings)} finding(s)"]))
    return 1 if findings else 0


def links() -> Iterator[str]:
    """Links that lead to no file or heading, or out of the project."""
    for page in PAGES:
        for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
            if link.startswith("../../actions/"):  # GitHub's own picture of the last run
                continue
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve() if name else page
            if link.startswith("http"):
                yield f"{page.relative_to(ROOT)}: {link} is outside of the project and may vanish"
            elif not target.exists() or MADE_BY_SPHINX in target.parents:
                yield f"{page.relative_to(ROOT)}: {link} leads to no file"
            elif anchor and anchor not in anchors(target):
                yield f"{page.relative_to(ROOT)}: {link} leads to no heading"


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as GitHub and MyST make them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in headings}


def site() -> Iterator[str]:
    """Pages that no table of contents of the site names."""
    index = (ROOT / "doc/index.md").read_text(encoding="utf-8")
    named = re.findall(r"^```{toctree}\n(.*?)^```", index, re.MULTILINE | re.DOTALL)
    in_site = {name for names in named for name in names.split()} | {"index"}
    for page in PAGES:
        if ROOT / "doc" in page.parents:
            name = page.relative_to(ROOT / "doc").with_suffix("").as_posix()
            if name not in in_site:
                yield f"doc/{name}.md is not in the site: name it in doc/index.md"


def sentences() -> Iterator[str]:
    """Long sentences of the pages that are read first, and a long README."""
    for page in READ_FIRST:
        lengths = words_per_sentence(page.read_text(encoding="utf-8"))
        if max(lengths) > 30 or sum(lengths) > 16 * len(lengths):
            mean = sum(lengths) / len(lengths)
            yield (
                f"{page.relative_to(ROOT)}: {max(lengths)} words in the longest sentence (at most "
                f"30), {mean:.1f} on average (at most 16)"
            )
    n_lines = len((ROOT / "README.md").read_text(encoding="utf-8").splitlines())
    if n_lines > 110:
        yield f"README.md has {n_lines} lines, at most 110 are read"


def words_per_sentence(text: str) -> list[int]:
    """Words of each sentence of the prose: no code, tables, headings or images."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"^(?: {4}|\||#|<!--|\[?!\[).*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)  # a link counts as its words
    text = re.sub(r"`[^`]*`", "code", text)
    parts = [
        part
        for paragraph in re.split(r"\n\s*\n|\n(?=[-*] |\d+\. )", text)
        for part in re.split(r"(?<=[.!?:])\s", " ".join(paragraph.split()))
    ]
    return [n for n in (len(re.findall(r"\w[^\s]*", part)) for part in parts) if n > 1]


def versions() -> Iterator[str]:
    """Versions that differ from that of package.xml."""
    version = ET.parse(ROOT / "package.xml").findtext("version")
    for name, pattern in (
        ("setup.py", r'version="(.+?)",'),
        (f"{PACKAGE}/__init__.py", r'__version__ = "(.+?)"'),
        ("CITATION.cff", r"^version: (\S+)$"),
        ("CHANGELOG.rst", r"^(\d+\.\d+\.\d+) \(.+\)\n-+$"),
    ):
        stated = re.search(pattern, (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE)
        if stated is None or stated[1].strip('"') != version:
            yield f"{name}: expected version {version} as in package.xml"


def manifest() -> Iterator[str]:
    """Imported packages that package.xml does not name."""
    declared = {e.text for e in ET.parse(ROOT / "package.xml").iter("exec_depend")}
    imported = {name.partition(".")[0] for source in SOURCES for name in imports_of(source)}
    for name in sorted(imported - set(sys.stdlib_module_names) - EXTRAS_ONLY - {PACKAGE}):
        if ROSDEP_NAMES.get(name, name) not in declared:
            yield f"package.xml: no exec_depend for '{name}'"


def commands() -> Iterator[str]:
    """Differences between the two commands of the README and those that CI runs."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    two = re.findall(r"^scripts/in_venv (\S+ python3 .+)$", readme, re.MULTILINE)[:2]
    if not two[0].endswith(f"-m {PACKAGE} demo --output demo_output"):
        yield f"README.md: the first command is not the demo: {two[0]}"
    if f"in_environment {two[1]}" not in (ROOT / ".ci/run").read_text(encoding="utf-8"):
        yield f".ci/run does not run the tests by the command of the README: {two[1]}"


def rooms() -> Iterator[str]:
    """Imports from later rooms, circles, and imports of rosbags outside of recordings/bags."""
    level = {room: i for i, layer in enumerate(LAYERS) for room in layer}
    imports: dict[str, set[str]] = {}
    for source in SOURCES:
        room = room_of(".".join(source.relative_to(ROOT).with_suffix("").parts))
        if room is None or room == "__init__":
            continue
        at_once = {room_of(name) for name in imports_of(source, when_loaded=True)}
        others = imports.setdefault(room, set())
        for other in {room_of(name) for name in imports_of(source)} - {None, room}:
            if other in at_once or (room, other) not in HANDED_ON:
                others.add(str(other))
    for room, others in imports.items():
        if room not in level:
            yield f"the room {room} needs its place in LAYERS of scripts/check_documents.py"
        for other in others:
            if level.get(other, 0) > level.get(room, 99):
                yield f"{room} imports {other}, a later room"
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        yield f"rooms import each other in a circle: {' → '.join(error.args[1])}"
    for source in SOURCES:
        uses = any(name.partition(".")[0] == "rosbags" for name in imports_of(source))
        if uses and source.parent != ROOT / PACKAGE / "recordings/bags":
            yield f"{source.name} imports rosbags: only recordings/bags may"


def imports_of(source: Path, *, when_loaded: bool = False) -> Iterator[str]:
    """Full names of all modules that a file imports anywhere in it, or when it is loaded."""
    package = source.relative_to(ROOT).parent.parts
    tree = ast.parse(source.read_text(encoding="utf-8"))
    for node in tree.body if when_loaded else ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(filter(None, [base, node.module]))
            yield from (f"{module}.{alias.name}" for alias in node.names)


def room_of(module: str) -> str | None:
    """The room of a module of this package; None for others and for the package itself."""
    package, _, inner = module.partition(".")
    room = inner.partition(".")[0]
    folder = ROOT / PACKAGE
    is_room = (folder / room).is_dir() or (folder / f"{room}.py").is_file()
    return room if package == PACKAGE and room and is_room else None


if __name__ == "__main__":
    sys.exit(main())
