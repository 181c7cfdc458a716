# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Runs that are interrupted and go on, against runs that are not."""

import hashlib
import os
import pickle
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.primitives.build import PrimitiveOptions, build_from_statistics
from mp_pca_planner.primitives.file import primitive_bytes
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.cache import ReadingCache
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.recording_set import RecordingSet
from mp_pca_planner.recordings.synthetic import continuous_recording, generate_motions

OPTIONS = PrimitiveOptions(n_components=3)
KILLED = """
import os, signal, sys
from test_resume import load
def progress(done, total):
    if done >= float(sys.argv[3]) * total:
        os.kill(os.getpid(), signal.SIGKILL)
load(sys.argv[1], sys.argv[2], progress=progress)
"""


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Four recordings, one of them damaged."""
    folder = tmp_path_factory.mktemp("made")
    for i in range(3):
        made = continuous_recording(generate_motions(1, i), seed=i)
        columns = made.joint_names, made.stamps, made.positions
        write_joint_states(folder / f"{i}.mcap", "mcap", *columns)
    files = {file.name: file.read_bytes() for file in sorted(folder.iterdir())}
    return {**files, "3.mcap": b"damaged"}


@pytest.fixture
def bags(content: dict[str, bytes], tmp_path: Path) -> Path:
    """A folder of the recordings."""
    folder = tmp_path / "bags"
    folder.mkdir()
    for name, one in content.items():
        (folder / name).write_bytes(one)
    return folder


def load(folder: str | Path, kept: str | Path | None = None, **options: object) -> RecordingSet:
    """Read the recordings."""
    summarise = partial(MotionStatistics.of, options=OPTIONS)
    return load_recordings(folder, summarise=summarise, most_samples=9, resume=kept, **options)


def learned(loaded: RecordingSet) -> tuple[object, ...]:
    """The bytes of the primitive that is learned, the samples that are kept, and the refusals."""
    statistics = MotionStatistics.merged(loaded.summaries)
    samples = [motion.positions.tobytes() for motion in loaded]
    file = primitive_bytes(build_from_statistics(statistics, "x", OPTIONS))
    return file, samples, [(one.recording, one.reason) for one in loaded.refused]


def hide_damage(file: Path) -> None:
    """Damage a file so that its size and time stay."""
    status = file.stat()
    file.write_bytes(b"x" * status.st_size)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_killed_run_goes_on_where_it_was(bags: Path, tmp_path: Path, jobs: int) -> None:
    expected, kept = learned(load(bags)), tmp_path / "kept"
    command = [sys.executable, "-c", KILLED, str(bags), str(kept), "0.6"]
    paths = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    killed = subprocess.run(command, env={**os.environ, "PYTHONPATH": paths}, check=False)
    assert killed.returncode == -signal.SIGKILL
    hide_damage(bags / "0.mcap")  # was read before
    assert learned(load(bags, kept, jobs=jobs)) == expected
    for file in bags.iterdir():
        hide_damage(file)
    assert learned(load(bags, kept)) == expected


def test_what_changed_is_read_again(bags: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    load(bags, kept)
    (bags / "0.mcap").write_bytes(b"damaged, too")
    assert [one.recording for one in load(bags, kept).refused] == ["0", "3"]
    (refused,) = load(bags / "1.mcap", kept, joints=["other"]).refused
    assert "'other'" in refused.reason


def test_a_damaged_file_is_read_again(bags: Path, tmp_path: Path) -> None:
    expected, kept = learned(load(bags)), tmp_path / "kept"
    load(bags, kept)
    whole = {file: file.read_bytes() for file in kept.iterdir()}
    assert len(whole) == 3
    for n in (-1, 40, 3, 0):
        for file, content in whole.items():
            file.write_bytes(content[:n])
        assert learned(load(bags, kept)) == expected
        assert {file: len(file.read_bytes()) for file in whole} == {
            file: len(content) for file, content in whole.items()
        }


def test_other_places_are_left_as_they_are(bags: Path, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text("recording,start_time_s,end_time_s\n")
    with pytest.raises(RecordingError, match="can't be the folder to resume from: File"):
        load(bags, tmp_path / "table.csv")
    with pytest.raises(RecordingError, match="holds other files: resume from a new folder"):
        load(bags, tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["bags", "table.csv"]


def test_sets_on_disk_are_those_in_memory(bags: Path) -> None:
    summarise = partial(MotionStatistics.of, options=OPTIONS)
    found, spooled = (
        load_recordings(bags, summarise=summarise, most_samples=9, on_disk=on_disk)
        for on_disk in (False, True)
    )
    assert learned(spooled) == learned(found)
    assert [len(x) for x in (spooled.reports, spooled.refused, spooled)] == [3, 1, len(found)]
    assert [one.name for one in spooled.reports[1:]] == [one.name for one in found.reports[1:]]
    for i in range(len(found)):
        assert spooled[i].recording == found[i].recording
    with pytest.raises(IndexError):
        spooled[len(found)]


class Hostile:
    """Calls a function when it is unpickled."""

    def __init__(self, function: object, *arguments: object) -> None:
        self._call = function, arguments

    def __reduce__(self) -> tuple:
        return self._call


@pytest.mark.parametrize("function", [os.mkdir, load_recordings, eval])
def test_a_hostile_file_calls_nothing(tmp_path: Path, function: object) -> None:
    place, kept = tmp_path / "made", ReadingCache(tmp_path)
    argument = f"__import__('os').mkdir({str(place)!r})" if function is eval else str(place)
    content = pickle.dumps(Hostile(function, argument))
    kept.keep("key", 1)
    assert kept.value("key") == 1
    (file,) = tmp_path.iterdir()
    file.write_bytes(hashlib.sha256(content).digest() + content)
    assert kept.value("key") is None
    assert not place.exists()
