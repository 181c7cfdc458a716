# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`build_library`: mixed recordings to a library that plans."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.motion_kinds import generate_kinds

from mp_pca_planner.primitives.build_library import known_motions
from mp_pca_planner.primitives.library import VersionedLibrary, load_primitives
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, continuous_recording

N_KINDS = 4


WORDS = ("build_library", "--segment", "none")
run = partial(command_line.run, *WORDS)
build = partial(command_line.result, *WORDS)
refusal = partial(command_line.refusal, *WORDS)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """24 recordings of one motion each, of four kinds in turn."""
    folder = tmp_path_factory.mktemp("bags")
    paths = []
    for i, motion in enumerate(generate_kinds(24, N_KINDS, 3)):
        made = continuous_recording([motion], seed=i)
        paths.append(folder / f"{i:02}.mcap")
        write_joint_states(paths[-1], "mcap", made.joint_names, made.stamps, made.positions)
    return paths


def recordings_by_kind(folder: Path) -> set[frozenset[str]]:
    return {
        frozenset(d["recording"] for d in primitive.metadata["demonstrations"])
        for primitive in load_primitives([folder])
    }


def test_every_kind_gets_a_primitive_and_the_report_shows_it(bags, tmp_path):
    pytest.importorskip("matplotlib")
    folder, page = tmp_path / "library", tmp_path / "page.html"
    facts = build(*bags, "--output", folder, "--report", page)
    (library,) = facts["libraries"]
    assert (facts["n_recordings"], library["n_motions"], library["outliers"]) == (24, 24, [])
    kinds = {frozenset(f"{i:02}" for i in range(k, 24, N_KINDS)) for k in range(N_KINDS)}
    assert recordings_by_kind(folder) == kinds
    text = page.read_text()
    assert all(kind["name"] in text for kind in library["kinds"])
    assert "another folder" in refusal(bags[0], "--output", folder)


def test_updates_give_the_library_of_all_recordings(bags, tmp_path):
    whole, grown = tmp_path / "whole", tmp_path / "grown"
    build(*bags, "--output", whole)
    build(*bags[:16], "--output", grown)
    build(*bags[14:20], "--output", grown, "--update")  # two of them are in already
    build(*bags[20:], "--output", grown, "--update")
    assert recordings_by_kind(grown) == recordings_by_kind(whole)
    pairs = [load_primitives([folder]) for folder in (whole, grown)]
    for one in pairs[0]:
        (other,) = (x for x in pairs[1] if np.allclose(x.total_variance, one.total_variance))
        np.testing.assert_allclose(other.mean_coefficients, one.mean_coefficients, atol=1e-9)
        np.testing.assert_allclose(other.explained_variance, one.explained_variance, rtol=1e-9)
    # What was learned of new motions is a new version; the history names all of them.
    used = VersionedLibrary(grown).in_use()
    assert max(used.values()) == 3


def test_a_recording_is_taken_out_again(bags, tmp_path):
    folder = tmp_path / "library"
    build(*bags, "--output", folder)
    build("--output", folder, "--update", "--remove", "05,06")
    left = set().union(*recordings_by_kind(folder))
    assert left == {f"{i:02}" for i in range(24)} - {"05", "06"}
    assert "no recordings called '05'" in refusal("--output", folder, "--update", "--remove", "05")


def test_outliers_are_kept_apart_and_become_a_kind_when_there_are_more(bags, tmp_path):
    folder = tmp_path / "library"
    # Two motions of the last kind only.
    few = [path for i, path in enumerate(bags) if i % N_KINDS < N_KINDS - 1 or i < 8]
    (library,) = build(*few, "--output", folder)["libraries"]
    assert [d["recording"] for d in library["outliers"]] == ["03", "07"]
    assert len(library["kinds"]) == N_KINDS - 1
    assert known_motions(VersionedLibrary(folder))[1] is not None
    rest = [path for path in bags if path not in few]
    (library,) = build(*rest, "--output", folder, "--update")["libraries"]
    assert (library["outliers"], len(library["kinds"])) == ([], N_KINDS)
    assert "outliers" not in {kind["name"] for kind in library["kinds"]}


def test_recordings_of_other_joints_go_to_a_library_of_their_own(bags, tmp_path):
    folder = tmp_path / "library"
    others = []
    for i, motion in enumerate(generate_kinds(6, 1, 5)):
        made = continuous_recording([motion], seed=i)
        others.append(tmp_path / f"other{i}.mcap")
        names = [*"abc", JOINT_NAMES[-1]]
        write_joint_states(others[-1], "mcap", names, made.stamps, made.positions)
    libraries = build(*bags, *others, "--output", folder)["libraries"]
    assert [x["n_motions"] for x in libraries] == [6, 24]
    assert {Path(x["output"]).name for x in libraries} == {
        "4_joints_to_elbow",
        "4_joints_to_elbow_2",
    }
    libraries = build(others[0], "--output", folder, "--update")["libraries"]
    assert [x["n_motions"] for x in libraries] == [6, 24]


def test_what_makes_no_sense_is_refused_in_one_line(bags, tmp_path):
    folder = tmp_path / "library"
    assert "no library" in refusal(bags[0], "--output", folder, "--update")
    assert "at least one recording" in refusal("--output", folder)
    assert not folder.exists()
