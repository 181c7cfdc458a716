# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The shipped arm against the formula of its kinematics and the paper's Table 1."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.arm import mass_matrix

from mp_pca_planner.files import config_file
from mp_pca_planner.robot.model import Robot

SHOULDER = np.array([-0.0154, -0.1667, 0.0788])
UPPER_ARM, FOREARM = 0.3447, 0.3074
TABLE_1 = {
    "chest": (29.27, (0.73, 0.63, 0.32)),
    "upper_arm": (2.97, (0.025, 0.025, 0.005)),
    "lower_arm": (1.21, (0.005, 0.0054, 0.0012)),
}
# What people did in the recordings the limits were chosen by [deg].
SEEN = {
    "shoulder1": (-136, 11),
    "shoulder2": (-64, 71),
    "shoulder3": (-71, 126),
    "elbow": (-152, -9),
}
MODEL = pin.buildModelFromXML(config_file("human_arm.urdf").read_text(encoding="utf-8"))
ROBOT = Robot.from_file(config_file("human_arm.urdf"))

configurations = st.tuples(
    *(
        st.floats(low, high)
        for low, high in zip(MODEL.lowerPositionLimit, MODEL.upperPositionLimit, strict=True)
    )
).map(np.array)


def closed_form(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    upper = Rotation.from_euler("Z", -50, degrees=True) * Rotation.from_euler("YXZ", q[:3])
    elbow = SHOULDER + upper.apply([0, 0, -UPPER_ARM])
    lower = upper * Rotation.from_euler("Y", q[3])
    return elbow, elbow + lower.apply([0, 0, -FOREARM])


@given(configurations)
def test_elbow_and_wrist_are_where_the_closed_form_says(q: np.ndarray) -> None:
    elbow, wrist = closed_form(q)
    points = ROBOT.frame_positions(q[None], ["lower_arm", "wrist"])[0]
    np.testing.assert_allclose(points, [elbow, wrist], rtol=0, atol=1e-12)


@pytest.mark.parametrize("link", TABLE_1)
def test_mass_and_inertia_are_those_of_table_1(link: str) -> None:
    mass, moments = TABLE_1[link]
    moved_by = {"chest": "universe", "upper_arm": "shoulder3", "lower_arm": "elbow"}
    body = MODEL.inertias[MODEL.getJointId(moved_by[link])]
    assert body.mass == pytest.approx(mass, abs=1e-12)
    np.testing.assert_allclose(body.inertia, np.diag(moments), atol=1e-12)


def test_centres_of_mass_of_the_arm_are_in_the_middle_of_the_links() -> None:
    for joint, length in (("shoulder3", UPPER_ARM), ("elbow", FOREARM)):
        lever = MODEL.inertias[MODEL.getJointId(joint)].lever
        np.testing.assert_allclose(lever, [0, 0, -length / 2], atol=1e-12)


@given(configurations)
def test_mass_matrix_is_positive_definite_within_the_limits(q: np.ndarray) -> None:
    eigenvalues = np.linalg.eigvalsh(mass_matrix(ROBOT, q))
    assert eigenvalues.min() > 1e-4


def test_arm_stretched_out_sideways_weighs_what_statics_says() -> None:
    # shoulder2 = 0 and shoulder1 = -90 degrees: the whole arm is horizontal, at a right angle to
    # the axis of shoulder1, which then carries all its weight.
    still = np.zeros((1, 4))
    tau = ROBOT.inverse_dynamics(np.array([[-np.pi / 2, 0, 0, 0]]), still, still)[0]
    moment = 9.81 * (2.97 * UPPER_ARM / 2 + 1.21 * (UPPER_ARM + FOREARM / 2))
    assert tau[0] == pytest.approx(-moment, rel=1e-9)
    assert tau[1] == pytest.approx(0, abs=1e-9)


def test_limits_leave_room_around_what_people_do() -> None:
    limits, margin = ROBOT.limits(), 7.9
    for i, (low, high) in enumerate(SEEN.values()):
        assert np.rad2deg(limits.lower[i]) <= low - margin
        assert np.rad2deg(limits.upper[i]) >= high + margin
    assert np.all(limits.velocity >= 10)
    assert np.all((limits.effort >= 40) & (limits.effort <= 100))
