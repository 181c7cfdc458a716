# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Libraries that keep their history: round trips, two writers at once, and sudden death."""

import json
import random
import resource
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from support.arm import arm_demonstrations, arm_primitive

from mp_pca_planner.cli.main import main
from mp_pca_planner.exceptions import PlannerError, PrimitiveError
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.primitives.library import VersionedLibrary, load_primitives
from mp_pca_planner.primitives.primitive import MovementPrimitive

pytest.importorskip("filelock", reason="the extra `library` is not installed")


def primitive(n_components: int = 3, name: str = "reach") -> MovementPrimitive:
    """One that differs from others by its number of components."""
    options = PrimitiveOptions(n_components=n_components)
    return build_primitive(arm_demonstrations(), name, options)


def components(folder: Path) -> int:
    (found,) = load_primitives([folder])
    return found.n_components


def test_versions_come_back(tmp_path: Path) -> None:
    library = VersionedLibrary(tmp_path / "library")
    for n in (2, 3, 4):
        library.add(primitive(n), f"{n} components")
    assert library.in_use() == {"reach": 3}
    assert components(library.folder) == 4
    library.roll_back("reach")
    assert components(library.folder) == 3
    library.roll_back("reach", 1)
    assert components(library.folder) == 2
    library.retire("reach")
    assert library.in_use() == {}
    assert not list(library.folder.glob("*.npz"))
    library.roll_back("reach")
    assert components(library.folder) == 2
    assert [c.action for c in library.history()][-3:] == ["rollback", "retire", "rollback"]
    assert library.history()[0].note == "2 components"
    assert library.history()[0].provenance["recordings"][0] == "motion_0"


def test_file_that_was_there_is_kept_as_a_version(tmp_path: Path) -> None:
    save_primitive(primitive(2), tmp_path / "reach.npz")
    library = VersionedLibrary(tmp_path)
    library.add(primitive(3))
    library.roll_back("reach")
    assert components(tmp_path) == 2


def test_what_a_killed_process_left_undone_is_taken_back_by_the_next_change(
    tmp_path: Path,
) -> None:
    library = VersionedLibrary(tmp_path)
    library.add(primitive(2))
    library.add(primitive(3))
    # Killed before the journal was written: there are a version and a file in use without a line.
    save_primitive(primitive(4), tmp_path / ".versions/reach/0003.npz")
    save_primitive(primitive(4), tmp_path / "reach.npz", overwrite=True)
    again = VersionedLibrary(tmp_path)
    assert again.in_use() == {"reach": 2}
    again.add(primitive(2, "other"))
    assert [p.n_components for p in load_primitives([tmp_path])] == [2, 3]
    assert again.add(primitive(2)).version == 4


def everything(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def line(**changed: object) -> str:
    content = {
        "action": "add",
        "name": "reach",
        "version": 1,
        "time": "",
        "author": "",
        "package_version": "",
        "provenance": {},
        "note": "",
    }
    return json.dumps(content | changed) + "\n"


@pytest.mark.parametrize(
    "content",
    [
        line(action="retire", name="{outside}", version=None),
        line(action="retire", name="../important", version=None),
        line(action="forget"),
        line(action="retire"),
        line(name=""),
        line(name="\ud800"),
        line(name=5),
        line(version="1"),
        line(version=True),
        line(time=[]),
        line(provenance=None),
        line(version=1).replace("1", "1" * 400),
        "[" * 100_000 + "\n",
        "\n",
        "\xff\n",
        "5\n",
    ],
)
def test_hostile_journals_are_refused_and_change_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str
) -> None:
    outside, folder = tmp_path / "important", tmp_path / "library"
    save_primitive(primitive(2), tmp_path / "important.npz")
    VersionedLibrary(folder).add(primitive())
    journal = folder / ".versions/journal.jsonl"
    journal.write_bytes(content.replace("{outside}", str(outside)).encode("latin-1"))
    before = everything(tmp_path)
    assert main(["library", "list", str(folder)]) == 2
    assert main(["library", "add", str(folder), str(tmp_path / "important.npz")]) == 2
    said = capsys.readouterr().err
    assert "journal.jsonl" in said and said.count("\n") == 2 and len(said) < 1500
    assert everything(tmp_path) == before


def test_reading_the_history_writes_nothing(tmp_path: Path) -> None:
    VersionedLibrary(tmp_path).add(primitive())
    (tmp_path / "reach.npz").unlink()
    (tmp_path / ".versions/lock").unlink(missing_ok=True)
    before = everything(tmp_path)
    assert (
        main(["library", "list", str(tmp_path)]) == main(["library", "history", str(tmp_path)]) == 0
    )
    assert everything(tmp_path) == before


def test_stray_files_among_the_versions_do_no_harm(tmp_path: Path) -> None:
    library = VersionedLibrary(tmp_path)
    library.add(primitive(2))
    for name in ("0001 (copy).npz", "1e5.npz", "9" * 200 + ".npz"):
        (tmp_path / ".versions/reach" / name).write_bytes(b"")
    assert library.add(primitive(3)).version == 2


def test_change_that_does_not_fit_on_the_disk_leaves_the_library_as_it_was(tmp_path: Path) -> None:
    library = VersionedLibrary(tmp_path)
    library.add(primitive(2), note="x" * 200_000)
    before = everything(tmp_path)
    # The journal is the largest file, and the last one.
    limit = (tmp_path / ".versions/journal.jsonl").stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        for change in (
            lambda: library.add(primitive(3)),
            lambda: library.add(primitive(3, "new")),
            lambda: library.retire("reach"),
        ):
            with pytest.raises(PlannerError, match="can't be written"):
                change()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert everything(tmp_path) == before
    assert not (tmp_path / ".versions/new").exists()


def test_refusals_name_what_is_wrong(tmp_path: Path) -> None:
    library = VersionedLibrary(tmp_path)
    library.add(primitive())
    with pytest.raises(PrimitiveError, match="did you mean 'reach'"):
        library.retire("reech")
    with pytest.raises(PrimitiveError, match="no version 7; it has 1"):
        library.roll_back("reach", 7)
    with pytest.raises(PrimitiveError, match="no earlier version"):
        library.roll_back("reach")
    with pytest.raises(PrimitiveError, match="can't be the name of a file"):
        library.add(primitive(2, "../reach"))
    (tmp_path / ".versions/journal.jsonl").write_text("{}\n")
    with pytest.raises(PrimitiveError, match="line 1 of .* is damaged"):
        VersionedLibrary(tmp_path)


def test_all_primitives_in_use_move_the_same_joints(tmp_path: Path) -> None:
    mine, library = primitive(), VersionedLibrary(tmp_path)
    others = tuple(f"other_{name}" for name in mine.joint_names)
    foreign = replace(mine, joint_names=others, name="foreign")
    with pytest.raises(PrimitiveError, match="'foreign' moves 'other_.*can't be used together"):
        library.change([mine, foreign], [], {}, n_before=0)
    library.add(replace(mine, joint_names=others))
    library.add(mine)  # in its place
    library.add(replace(mine, name="second"))
    for change in (lambda: library.add(foreign), lambda: library.roll_back("reach", 1)):
        with pytest.raises(PrimitiveError, match="of the library moves 'shoulder1'"):
            change()
    assert library.in_use() == {"reach": 2, "second": 1}


WRITER = """
import sys
from mp_pca_planner.primitives.file import load_primitive
from mp_pca_planner.primitives.library import VersionedLibrary
found = load_primitive(sys.argv[2])
print("ready", flush=True)
while True:
    VersionedLibrary(sys.argv[1]).add(found)
    print("added", flush=True)
"""


def writer(folder: Path, file: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder), str(file)], stdout=subprocess.PIPE, text=True
    )


def test_two_processes_and_sudden_death_lose_nothing(tmp_path: Path) -> None:
    folder, rng = tmp_path / "library", random.Random(0)
    files = [tmp_path / f"{name}.npz" for name in ("one", "two")]
    for n, file in enumerate(files, start=2):
        save_primitive(primitive(n, file.stem), file)
    acknowledged = [0, 0]
    for _ in range(3):
        writers = [writer(folder, file) for file in files]
        # They are killed while they go on adding, whatever they are at.
        for process in writers:
            assert process.stdout is not None
            for _ in range(rng.randint(2, 6)):
                process.stdout.readline()
        for process in writers:
            process.send_signal(signal.SIGKILL)
            process.communicate()
        library = VersionedLibrary(folder)
        history = library.history()
        for i, file in enumerate(files):
            added = [c for c in history if c.name == file.stem]
            assert len(added) > acknowledged[i]
            acknowledged[i] = len(added)
        found = load_primitives([folder])
        assert {p.name: p.n_components for p in found} == {"one": 2, "two": 3}
        for change in history:
            assert (folder / ".versions" / change.name / f"{change.version:04}.npz").is_file()


def test_command_adds_lists_and_rolls_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(tmp_path / "library")
    for n in (2, 3):
        save_primitive(primitive(n), tmp_path / "new.npz", overwrite=True)
        assert (
            main(["library", "add", folder, str(tmp_path / "new.npz"), "--note", f"with {n}"]) == 0
        )
    assert main(["library", "rollback", folder, "reach", "--json"]) == 0
    changes = json.loads(capsys.readouterr().out.splitlines()[-1])["changes"]
    assert [c["version"] for c in changes] == [1]
    assert components(tmp_path / "library") == 2
    assert main(["library", "history", folder]) == 0
    assert "with 3" in capsys.readouterr().out
    assert main(["library", "retire", folder]) == 2
    assert "needs at least one" in capsys.readouterr().err
    assert main(["library", "list", str(tmp_path / "nothing")]) == 2
    assert main(["library", "list", folder]) == 0
    assert arm_primitive().name not in capsys.readouterr().out
