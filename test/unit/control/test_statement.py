# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Statements on the stability of a primitive's control law, and what becomes of them."""

import contextlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from support.arm import JOINTS, arm_primitive

from mp_pca_planner.cli.main import main
from mp_pca_planner.control.law import (
    FEEDFORWARD_PD,
    NO_LAW,
    ControlLaw,
    control_statement,
    pair_law,
    paired_law,
)
from mp_pca_planner.exceptions import ControlError, PrimitiveError
from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import load_primitive, save_primitive

URDF = str(config_file("human_arm.urdf"))
START, GOAL = [-0.5, -0.9, 0.9, -0.5], [-0.2, -0.4, 0.9, -0.9]
REQUEST = ["--robot", URDF]
for option, values in (("--start", START), ("--goal", GOAL)):
    REQUEST += [option, ",".join(map(str, values))]
LAW = ControlLaw(FEEDFORWARD_PD, JOINTS, np.full(4, 100.0), np.full(4, 10.0))


@pytest.fixture(scope="module")
def verified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """File of a primitive with the control law that `verify` printed, and the bound of it."""
    folder = tmp_path_factory.mktemp("verified")
    save_primitive(arm_primitive(), folder / "reach.npz")
    path = folder / "paired.npz"
    options = ["--output", str(path), "--trials", "2", "--json"]
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main(["verify", str(folder / "reach.npz"), *REQUEST, *options]) == 0
    facts, found = json.loads(out.getvalue()), load_primitive(path)
    assert facts["bound_held"] == facts["n_trials"] == 2 and facts["saturated"] == 0
    law = paired_law(found)
    assert law is not None and law.position_gains.tolist() == facts["position_gains"]
    text, bounds = control_statement(found), zip(JOINTS, facts["error_bound"], strict=True)
    assert ", ".join(f"{name}={b:.6g}" for name, b in bounds) in text
    for words in (
        f"to shoulder1=-0.2, shoulder2=-0.4, shoulder3=0.9, elbow=-0.9 in {facts['duration']:.6g}",
        "within 5 %",
        "the start within 0.001 rad,",
    ):
        assert words in text
    return path


def test_statement_says_what_it_excludes_and_how_much_friction_it_holds_for(
    verified: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    without = control_statement(load_primitive(verified))
    assert "elbow=0 N·m," in without and "elbow=0 kg·m²" in without
    other = str(tmp_path / "other.npz")
    options = ["--friction", "elbow=0.01", "--armature", "0.01", "--trials", "2", "--output", other]
    assert main(["verify", str(verified), *REQUEST, *options]) == 0
    assert "not included" in capsys.readouterr().out
    text = control_statement(load_primitive(other))
    assert "elbow=0.01 N·m," in text and "elbow=0.01 kg·m²" in text


def test_without_a_bound_the_remedy_is_named(
    verified: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option, words in (("--friction", "less --friction"), ("--inertia-error", "--armature")):
        assert main(["verify", str(verified), *REQUEST, option, "0.6", "--trials", "1"]) == 1
        out = capsys.readouterr().out
        assert "no error bound on the motion from" in out
        assert "there is no bound: " in out and words in out


def test_what_is_no_law_is_refused_and_said(
    verified: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["verify", str(verified), *REQUEST, "--output", str(verified)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main(["inspect", str(verified)]) == 0
    assert control_statement(load_primitive(verified)) in capsys.readouterr().out
    assert control_statement(arm_primitive()) == NO_LAW
    primitive = pair_law(arm_primitive(), LAW)
    assert "no error bound: run verify" in control_statement(primitive)
    primitive.metadata["control_law"]["velocity_gains"][0] = -1.0
    assert "unusable: " in control_statement(primitive)
    with pytest.raises(PrimitiveError, match="can't be used: velocity_gains must be positive"):
        paired_law(primitive)
    with pytest.raises(ControlError, match="must be one of 'feedforward_pd'"):
        ControlLaw("pid", JOINTS, np.ones(4), np.ones(4))


def test_refined_primitive_keeps_gains_but_not_the_bound(verified: Path, tmp_path: Path) -> None:
    output = tmp_path / "refined.npz"
    assert main(["refine", str(verified), *REQUEST, "--output", str(output)]) == 0
    refined = load_primitive(output)
    before, after = paired_law(load_primitive(verified)), paired_law(refined)
    assert before is not None
    assert after is not None
    assert np.array_equal(after.position_gains, before.position_gains)
    assert np.array_equal(after.velocity_gains, before.velocity_gains)
    assert "no error bound: run verify" in control_statement(refined)
