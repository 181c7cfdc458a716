# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Adding recordings to a primitive, and taking them out, without reading the old ones."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from test_build_primitives import build, refusal

from mp_pca_planner.primitives.file import load_primitive
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.synthetic import continuous_recording, generate_motions


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Recordings of three motions each."""
    folder = tmp_path_factory.mktemp("bags")
    paths = [folder / f"{'cab'[i]}.mcap" for i in range(3)]
    for seed, path in enumerate(paths):
        made = continuous_recording(generate_motions(3, seed), seed=seed)
        write_joint_states(path, "mcap", made.joint_names, made.stamps, made.positions)
    return paths


def assert_equal_but_for_the_order(one: Path, other: Path) -> None:
    """All arrays agree to 1e-9 once the demonstrations are in one order."""
    first, second = load_primitive(one), load_primitive(other)
    orders = [np.argsort(x.durations) for x in (first, second)]
    for name, array in first.arrays().items():
        pair = [array, second.arrays()[name]]
        if name in ("weights", "boundary_states", "durations", "warps", "fit_residual"):
            pair = [x[order] for x, order in zip(pair, orders, strict=True)]
        elif name in ("requests", "shape_coefficients", "pace_coefficients"):
            axis = 0 if name == "requests" else 3
            pair = [np.take(x, o, axis) for x, o in zip(pair, orders, strict=True)]
        elif name == "duration_coefficients":
            pair = [x[:, :, :, o] for x, o in zip(pair, orders, strict=True)]
        scale = np.abs(array).max(initial=1e-12)
        np.testing.assert_allclose(*pair, rtol=0.0, atol=1e-9 * scale, err_msg=name)
    for key in ("repairs", "options"):
        assert first.metadata[key] == second.metadata[key]
    for name, shares in first.metadata["angle_variance_ratio"].items():
        np.testing.assert_allclose(second.metadata["angle_variance_ratio"][name], shares, 1e-9)


@pytest.mark.parametrize("options", [(), ("--coupling", "joint", "--align", "linear")])
def test_updates_give_what_a_build_from_all_recordings_gives(bags, tmp_path, options):
    whole, grown = tmp_path / "whole.npz", tmp_path / "grown.npz"
    build(*bags, "--output", whole, "--name", "x", *options)
    build(bags[0], "--output", grown, "--name", "x", *options)
    hidden = bags[0].rename(tmp_path / "old.mcap")  # must not be read again
    try:
        for bag in bags[1:]:
            build(bag, "--update", grown)
    finally:
        hidden.rename(bags[0])
    assert_equal_but_for_the_order(whole, grown)


def test_a_recording_taken_out_is_as_if_it_had_never_been_in(bags, tmp_path):
    two, three = tmp_path / "two.npz", tmp_path / "three.npz"
    build(*bags[:2], "--output", two, "--name", "x")
    build(*bags, "--output", three, "--name", "x")
    build("--update", three, "--remove", bags[2].stem)
    assert_equal_but_for_the_order(two, three)


def test_a_recording_that_is_in_already_is_counted_once_under_any_name(bags, tmp_path):
    file, before = tmp_path / "p.npz", tmp_path / "before.npz"
    n_motions = build(*bags, "--output", file)["n_motions"]
    shutil.copy(file, before)
    copy = shutil.copy(bags[0], tmp_path / "copy.mcap")
    assert build(copy, bags[1], "--update", file)["n_motions"] == n_motions
    assert_equal_but_for_the_order(before, file)


def test_other_components_need_no_recordings(bags, tmp_path):
    file, direct = tmp_path / "p.npz", tmp_path / "direct.npz"
    build(*bags, "--output", file, "--name", "x")
    build("--update", file, "--components", "2", "--output", file, "--force")
    build(*bags, "--output", direct, "--name", "x", "--components", "2")
    assert_equal_but_for_the_order(direct, file)


def test_updates_that_make_no_sense_are_refused_in_one_line(bags, tmp_path):
    file = tmp_path / "p.npz"
    build(*bags, "--output", file)
    before = file.read_bytes()
    assert "valid names: 'a', 'b', 'c'" in refusal("--update", file, "--remove", "d")
    assert "nothing would be left" in refusal("--update", file, "--remove", "a,b,c")
    assert "was built with degree 15" in refusal(bags[0], "--update", file, "--degree", "20")
    assert "also pass --update" in refusal(bags[0], "--output", tmp_path / "x.npz", "--remove", "a")
    assert "at least one recording" in refusal("--output", tmp_path / "x.npz")
    assert file.read_bytes() == before
