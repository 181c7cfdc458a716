# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What was read of recordings is not read again."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.cache import ReadingCache
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.recording_set import RecordingSet
from mp_pca_planner.recordings.synthetic import continuous_recording, generate_motions


def write(path: Path, seed: int, bag_format: str) -> Path:
    made = continuous_recording(generate_motions(2, seed), seed=seed)
    write_joint_states(path, bag_format, made.joint_names, made.stamps, made.positions)
    return path


@pytest.fixture
def cache(tmp_path: Path) -> ReadingCache:
    return ReadingCache(tmp_path / "cache")


def assert_same(one: RecordingSet, other: RecordingSet) -> None:
    assert one.refused == other.refused
    assert [x.repairs for x in one.reports] == [x.repairs for x in other.reports]
    assert [x.notes for x in one.reports] == [x.notes for x in other.reports]
    for first, second in zip(one, other, strict=True):
        assert first.checksum == second.checksum
        np.testing.assert_array_equal(first.times, second.times)
        np.testing.assert_array_equal(first.positions, second.positions)


def spoil(folder: Path) -> None:
    """Overwrite every file of a recording, so that reading it fails; sizes and times stay."""
    for file in [folder] if folder.is_file() else folder.iterdir():
        status = file.stat()
        file.write_bytes(bytes(status.st_size))
        os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


@pytest.mark.parametrize("name", ["x.mcap", "folder", "x.bag"])
def test_a_recording_is_read_once_whatever_is_done_with_its_motions(name, tmp_path, cache):
    path = write(tmp_path / name, 0, "rosbag1" if name.endswith("bag") else "mcap")
    plain = load_recordings(path)
    uncut = load_recordings(path, segment="none")
    assert_same(load_recordings(path, cache=cache), plain)
    metadata = path / "metadata.yaml"
    kept = metadata.read_bytes() if metadata.exists() else None
    spoil(path)
    if kept is not None:
        status = metadata.stat()
        metadata.write_bytes(kept)
        os.utime(metadata, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert_same(load_recordings(path, cache=cache), plain)
    assert_same(load_recordings(path, cache=cache, segment="none"), uncut)
    assert load_recordings(path).refused


def test_a_recording_that_changed_is_read_again(tmp_path, cache):
    path = write(tmp_path / "x.mcap", 0, "mcap")
    load_recordings(path, cache=cache)
    path.unlink()
    write(path, 1, "mcap")
    assert_same(load_recordings(path, cache=cache), load_recordings(path))


def test_other_options_of_reading_give_what_they_give_without_a_cache(tmp_path, cache):
    path = write(tmp_path / "x.mcap", 0, "mcap")
    for joints in (["elbow"], ["shoulder1", "elbow"], None):
        expected = load_recordings(path, joints=joints)
        assert_same(load_recordings(path, joints=joints, cache=cache), expected)


def test_copies_of_a_recording_share_what_is_kept(tmp_path, cache):
    path = write(tmp_path / "x.mcap", 0, "mcap")
    load_recordings(path, cache=cache)
    (tmp_path / "other").mkdir()
    copy = shutil.copy(path, tmp_path / "other" / "x.mcap")
    load_recordings(copy, cache=cache)
    # A checksum for each, and the joint states.
    assert len(list(cache.folder.iterdir())) == 3


def test_damaged_files_and_folders_that_cannot_be_written_do_no_harm(tmp_path, cache):
    path = write(tmp_path / "x.mcap", 0, "mcap")
    plain = load_recordings(path)
    load_recordings(path, cache=cache)
    for file in cache.folder.iterdir():
        file.write_bytes(b"damaged")
    assert_same(load_recordings(path, cache=cache), plain)
    assert_same(load_recordings(path, cache=cache), plain)
    assert_same(load_recordings(path, cache=ReadingCache(path / "no folder")), plain)


def test_metadata_that_is_no_text_is_refused_as_without_a_cache(tmp_path, cache):
    path = write(tmp_path / "folder", 0, "mcap")
    (path / "metadata.yaml").write_bytes(b"\xff\xfe")
    assert load_recordings(path, cache=cache).refused == load_recordings(path).refused


def test_what_was_used_first_is_deleted_when_the_cache_is_full(tmp_path, cache):
    paths = [write(tmp_path / f"{i}.mcap", i, "mcap") for i in range(3)]
    load_recordings(paths, cache=cache)
    size = sum(file.stat().st_size for file in cache.folder.iterdir())
    for i, file in enumerate(sorted(cache.folder.iterdir())):
        os.utime(file, (i, i))
    oldest = min(cache.folder.iterdir())
    ReadingCache(cache.folder, size - 1).prune()
    assert not oldest.exists()
    assert len(list(cache.folder.iterdir())) == 5
