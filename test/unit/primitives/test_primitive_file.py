# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Primitive files: round trips, and refusals that name the file and the reason."""

import dataclasses
import io
import os
import zipfile
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.arm import arm_demonstrations, arm_primitive
from support.forged import forge, rewrite

from mp_pca_planner.exceptions import PlannerError, PrimitiveError
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.file import load_primitive, save_primitive
from mp_pca_planner.primitives.library import load_primitives


def assert_same(one, other):
    """All arrays of two primitives are equal."""
    for own, others in ((one, other), (one.model, other.model)):
        for field in dataclasses.fields(own):
            if isinstance(getattr(own, field.name), np.ndarray):
                np.testing.assert_array_equal(getattr(own, field.name), getattr(others, field.name))


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "primitive.npz"
    save_primitive(arm_primitive(), file)
    return file


def test_a_file_is_saved_under_its_ending_only(tmp_path):
    with pytest.raises(PlannerError, match=r"'.*x\.txt' must end in \.npz"):
        arm_primitive().save(tmp_path / "x.txt")
    assert not list(tmp_path.iterdir())


def test_what_was_saved_is_loaded(path):
    saved, loaded = arm_primitive(), load_primitive(path)
    assert (loaded.name, loaded.joint_names) == (saved.name, saved.joint_names)
    assert loaded.coupling == saved.coupling
    assert_same(loaded, saved)
    assert loaded.metadata["demonstrations"] == saved.metadata["demonstrations"]


def test_building_again_gives_the_same_bytes(tmp_path):
    files = [tmp_path / name for name in ("one.npz", "two.npz")]
    for file in files:
        primitive = build_primitive(arm_demonstrations(), "same", PrimitiveOptions(n_components=3))
        save_primitive(primitive, file)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_loaded_primitive_is_saved_to_the_same_bytes(path, tmp_path):
    again = tmp_path / "again.npz"
    save_primitive(load_primitive(path), again)
    assert again.read_bytes() == path.read_bytes()


def test_a_loaded_primitive_predicts_what_the_saved_one_predicted(path):
    start, goal = arm_primitive().boundary_states[0, [0, 3]]
    for duration in (None, 0.7):
        found, again = (
            primitive.model.predict(start, goal + 0.3, duration)
            for primitive in (arm_primitive(), load_primitive(path))
        )
        for field in dataclasses.fields(found):
            np.testing.assert_array_equal(getattr(again, field.name), getattr(found, field.name))


def test_primitives_are_frozen(path):
    loaded = load_primitive(path)
    with pytest.raises(dataclasses.FrozenInstanceError):
        loaded.name = "other"
    for owner in (loaded, loaded.model):
        for field in dataclasses.fields(owner):
            value = getattr(owner, field.name)
            assert not (isinstance(value, np.ndarray) and value.flags.writeable)


def test_an_existing_file_is_not_overwritten(path):
    before = path.read_bytes()
    with pytest.raises(PlannerError, match="exists already"):
        save_primitive(arm_primitive("joint"), path)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a, m: m.update(format="else"), "not made by this package"),
        (
            lambda a, m: m.update(format_version=3),
            "version is 3, this release reads version 4: build it again",
        ),
        (lambda a, m: a.pop("weights"), "lacks the arrays weights"),
        (lambda a, m: a.update(weights=a["weights"] + 1e-12), "checksum"),
        (lambda a, m: m.update(name="other"), "checksum"),
        (
            lambda a, m: a.update(weights=a["weights"].astype(np.float32)),
            "of float32, expected .* of float64",
        ),
        (lambda a, m: a.update(weights=np.array(["x"])), "of <U1, expected"),
    ],
)
def test_a_changed_file_is_refused_with_its_name_and_the_reason(path, change, message):
    rewrite(path, change)
    with pytest.raises(PrimitiveError, match=rf"primitive\.npz' is rejected: .*{message}"):
        load_primitive(path)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("weights", lambda x: x[:, :2], "has shape .*, expected"),
        ("durations", lambda x: -x, r"'durations' holds -.*, expected 1e-09 to 1e\+09"),
        ("durations", lambda x: x * np.nan, "'durations' holds nan, expected"),
        ("shape_coefficients", lambda x: x[:, :, 1:], "has shape .*, expected"),
        ("pace_coefficients", lambda x: x * np.inf, "'pace_coefficients' holds -?(inf|nan)"),
        ("requests", lambda x: x + 1.1e6, r"'requests' holds .*, expected -1e\+06 to 1e\+06"),
        ("requests", lambda x: x + 100.0, "'requests' holds durations that are not up to"),
        ("explained_variance", lambda x: -x, "'explained_variance' holds -"),
        ("explained_variance", lambda x: 0.0 * x, "'explained_variance' holds 0"),
        ("request_precision", lambda x: 0.0 * x, "'request_precision' is not positive definite"),
        ("warps", lambda x: 2.0 * x, "'warps' holds .*, expected 0 to 1"),
        ("mean_coefficients", lambda x: 1e300 * x, "'mean_coefficients' holds"),
        ("requests", lambda x: x[:, 1:], "has shape .*, expected"),
        ("shape_coefficients", lambda x: x[:, :1], "has shape .*, expected"),
        ("mean_coefficients", lambda x: x[0], "has shape .*, expected"),
    ],
)
def test_content_that_fits_its_checksum_but_makes_no_sense_is_refused(path, name, change, message):
    forge(path, lambda a, m: a.update({name: change(a[name])}))
    with pytest.raises(PrimitiveError, match=message):
        load_primitive(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint_names": 5}, "it.joint_names is 5, expected a list"),
        ({"joint_names": None}, "it.joint_names is None, expected a list"),
        ({"joint_names": [1, 2, 3, 4]}, r"it.joint_names\[0\] is 1, expected text"),
        ({"name": None}, "it.name is None, expected text"),
        ({"coupling": []}, "it.coupling is \\[\\], expected text"),
        ({"format_version": [4]}, "it.format_version is .*, expected an integer"),
        ({"prismatic_joints": 1}, "expected a list"),
        ({"angle_variance_ratio": {"elbow": ["x"]}}, "expected a number"),
        ({"angle_variance_ratio": [0.5]}, "expected an object"),
        ({"demonstrations": {}}, "expected a list"),
        ({"demonstrations": []}, "'weights' has shape"),
        ({"demonstrations": [{"recording": 5}]}, "expected text"),
        ({"demonstrations": [{"recording": "x"}]}, "expected an object with 'label'"),
        ({"refined_from": "x"}, "expected an object"),
    ],
)
def test_metadata_of_another_form_is_refused(path, change, message):
    forge(path, lambda a, m: m.update(change))
    with pytest.raises(PrimitiveError, match=message):
        load_primitive(path)


@pytest.mark.parametrize("degree", [4, 3000])
def test_polynomials_of_an_extreme_degree_are_refused(path, degree):
    def change(arrays, _metadata):
        for name in ("mean_coefficients", "component_coefficients"):
            arrays[name] = np.zeros((*arrays[name].shape[:-1], degree + 1))

    forge(path, change)
    with pytest.raises(PrimitiveError, match=f"of degree {degree}, expected 6 to 30"):
        load_primitive(path)


def test_what_a_file_holds_is_no_larger_than_the_file(path):
    with np.load(path) as content:
        arrays = {name: content[name] for name in content.files}
    np.savez_compressed(path, zeros=np.zeros(10_000_000), **arrays)
    assert path.stat().st_size < 1_000_000
    with pytest.raises(PrimitiveError, match="claims to hold .* at most its size on the disk"):
        load_primitive(path)


def test_files_with_statistics_of_their_demonstrations_are_read(path):
    """Earlier files hold more arrays, which predictions don't need."""

    def change(arrays, metadata):
        arrays["extents"] = np.ones(3)
        del metadata["left_out_error"], metadata["minimum_jerk_error"]

    forge(path, change)
    loaded = load_primitive(path)
    assert_same(loaded, arm_primitive())
    assert np.isnan(loaded.summary()["left_out_error"])


def test_printing_computes_nothing(path, monkeypatch):
    loaded, expected = load_primitive(path), str(arm_primitive())
    monkeypatch.setattr("mp_pca_planner.primitives.build.left_out_errors", None)
    monkeypatch.setattr("mp_pca_planner.primitives.prediction._fit", None)
    assert str(loaded) == expected and "left-out motions: " in expected


def test_metadata_that_nests_deeply_is_refused(path):
    with np.load(path) as content:
        arrays = {name: content[name] for name in content.files}
    arrays["metadata"] = np.array('{"a": ' + "[" * 100_000 + "]" * 100_000 + "}")
    np.savez(path, **arrays)
    with pytest.raises(PrimitiveError, match="nested too deeply"):
        load_primitive(path)


def test_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(PrimitiveError, match="not a regular file"):
        load_primitive(tmp_path / "pipe.npz")


def test_motions_that_are_all_the_same_are_refused_or_learned():
    motion = arm_demonstrations()[0]
    for n in range(1, 12):
        with suppress(PrimitiveError):
            build_primitive([motion] * n, "same")


def test_pickled_content_is_not_executed(tmp_path):
    path = tmp_path / "pickle.npz"
    np.savez(path, metadata=np.array("{}"), weights=np.array([{}, None], dtype=object))
    with pytest.raises(PrimitiveError, match="allow_pickle"):
        load_primitive(path)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04rest"])
def test_what_is_no_npz_is_refused(tmp_path, content):
    path = tmp_path / "file.npz"
    path.write_bytes(content)
    with pytest.raises(
        PrimitiveError, match=r"not a complete \.npz file.*that build_primitives made"
    ):
        load_primitive(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(PrimitiveError, match="No such file"):
        load_primitive(tmp_path / "nowhere.npz")
    with pytest.raises(PrimitiveError, match="can't be read|Is a directory"):
        load_primitive(tmp_path)


def test_a_file_that_claims_to_be_huge_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "bomb.npz"
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 40,)}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("weights.npy", header.getvalue())
    with pytest.raises(PrimitiveError, match="can't be read"):
        load_primitive(path)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damage_anywhere_is_refused_or_harmless(path, tmp_path, data):
    content = bytearray(path.read_bytes())
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content) - 1))]
    else:
        for _ in range(data.draw(st.integers(1, 4))):
            position = data.draw(st.integers(0, len(content) - 1))
            content[position] ^= data.draw(st.integers(1, 255))
    damaged = tmp_path / "damaged.npz"
    damaged.write_bytes(content)
    try:
        loaded = load_primitive(damaged)
    except PrimitiveError:
        return
    # Nothing that matters was hit: padding of the archive, or a date in it.
    assert_same(loaded, arm_primitive())


def test_folders_and_files_make_a_library(path, tmp_path):
    folder = tmp_path / "more"
    folder.mkdir()
    (folder / "notes.txt").write_text("no primitive")
    save_primitive(arm_primitive("joint"), folder / "b.npz")
    save_primitive(arm_primitive("joint", 2), folder / "a.npz")
    names = [p.name for p in load_primitives([folder, path])]
    assert names == ["arm_joint_2", "arm_joint_4", "arm_arm_4"]


def test_a_library_without_files_or_with_a_name_twice_is_refused(path, tmp_path):
    with pytest.raises(PrimitiveError, match="no primitive file was named"):
        load_primitives([])
    (tmp_path / "empty").mkdir()
    with pytest.raises(PrimitiveError, match="empty' holds no primitive file"):
        load_primitives([tmp_path / "empty"])
    save_primitive(arm_primitive(), tmp_path / "twin.npz")
    with pytest.raises(PrimitiveError, match=r"twin\.npz.*primitive\.npz.*'arm_arm_4'"):
        load_primitives([path, tmp_path / "twin.npz"])
