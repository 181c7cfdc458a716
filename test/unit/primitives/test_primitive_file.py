# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Primitive files: round trips, and refusals that name the file and the reason."""

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.arm import arm_demonstrations, arm_primitive, file_bytes
from support.forged import forge, rewrite

from mp_pca_planner.exceptions import PlannerError, PrimitiveError
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.file import load_primitive, save_primitive


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


def test_the_same_demonstrations_and_a_loaded_primitive_give_the_same_bytes(path, tmp_path):
    again = tmp_path / "again.npz"
    save_primitive(load_primitive(path), again)
    assert again.read_bytes() == path.read_bytes()
    options = PrimitiveOptions(n_components=4)
    built = build_primitive(arm_demonstrations(), "arm_arm_4", options)
    assert file_bytes(built) == path.read_bytes()
    loaded = load_primitive(again)
    assert loaded.metadata["demonstrations"] == arm_primitive().metadata["demonstrations"]
    assert_same(loaded, arm_primitive())


def test_a_file_is_saved_under_its_ending_and_not_over_another(path, tmp_path):
    before = path.read_bytes()
    with pytest.raises(PlannerError, match="exists already"):
        arm_primitive("joint").save(path)
    with pytest.raises(PlannerError, match=r"'.*x\.txt' must end in \.npz"):
        arm_primitive().save(tmp_path / "x.txt")
    assert list(tmp_path.iterdir()) == [path] and path.read_bytes() == before


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("weights", lambda x: None, "lacks the arrays weights"),
        ("weights", lambda x: x.astype(np.float32), "of float32, expected .* of float64"),
        ("durations", lambda x: -x, r"'durations' holds -.*, expected 1e-09 to 1e\+09"),
        ("requests", lambda x: x + 100.0, "'requests' holds durations that are not up to"),
        ("request_precision", lambda x: 0.0 * x, "'request_precision' is not positive definite"),
        (
            "mean_coefficients",
            lambda x: x[:, :5],
            "number of degrees must be .* 7 to 31, got 5",
        ),
        ("format", "else", "it is a else of format version 4"),
        ("format_version", 3, "version 3, this release reads version 4 of .*: build it again"),
        ("coupling", "leg", "coupling must be one of 'joint', 'arm', got 'leg'"),
        ("demonstrations", [], "'weights' has shape"),
        ("demonstrations", [{"recording": "x"}], "expected an object with 'label'"),
    ],
)
def test_content_that_fits_its_checksum_but_makes_no_sense_is_refused(path, name, change, message):
    def put(arrays, metadata):
        if not callable(change):
            metadata[name] = change
        elif (changed := change(arrays.pop(name))) is not None:
            arrays[name] = changed
        if name == "mean_coefficients" and arrays[name].ndim == 2:
            size = *arrays["component_coefficients"].shape[:2], arrays[name].shape[1]
            arrays["component_coefficients"] = np.zeros(size)

    forge(path, put)
    with pytest.raises(PrimitiveError, match=rf"primitive\.npz' is rejected: .*{message}"):
        load_primitive(path)


def test_what_is_no_primitive_file_is_refused(path, tmp_path):
    (tmp_path / "cut.npz").write_bytes(path.read_bytes()[:-100])
    (tmp_path / "empty.npz").touch()
    rewrite(path, lambda a, m: m.update(name="other"))
    for name, message in (
        ("cut.npz", r"not a complete \.npz file.*that build_primitives made"),
        ("empty.npz", r"not a complete \.npz file"),
        ("primitive.npz", "does not match its checksum"),
        ("nowhere.npz", "No such file"),
        ("", "can't be read|Is a directory"),
    ):
        with pytest.raises(PrimitiveError, match=message):
            load_primitive(tmp_path / name)


def test_what_a_file_holds_is_no_larger_than_the_file(path):
    with np.load(path) as content:
        arrays = {name: content[name] for name in content.files}
    np.savez_compressed(path, zeros=np.zeros(10_000_000), **arrays)
    assert path.stat().st_size < 1_000_000
    with pytest.raises(PrimitiveError, match="claims to hold .* at most its size on the disk"):
        load_primitive(path)


def test_pickled_content_is_not_executed(tmp_path):
    path = tmp_path / "pickle.npz"
    np.savez(path, metadata=np.array("{}"), weights=np.array([{}, None], dtype=object))
    with pytest.raises(PrimitiveError, match="allow_pickle"):
        load_primitive(path)


@settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
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
