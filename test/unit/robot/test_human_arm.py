# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The shipped arm against the formula of its kinematics and the paper's Table 1."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.arm import arm_robot, mass_matrix

from mp_pca_planner.files import config_file

SHOULDER = np.array([-0.0154, -0.1667, 0.0788])
UPPER_ARM, FOREARM = 0.3447, 0.3074
# Mass and moments of inertia by the joint that moves the link, and its length.
TABLE_1 = {
    "universe": (29.27, (0.73, 0.63, 0.32), None),
    "shoulder3": (2.97, (0.025, 0.025, 0.005), UPPER_ARM),
    "elbow": (1.21, (0.005, 0.0054, 0.0012), FOREARM),
}
MODEL = pin.buildModelFromXML(config_file("human_arm.urdf").read_text(encoding="utf-8"))
LIMITS = zip(MODEL.lowerPositionLimit, MODEL.upperPositionLimit, strict=True)


@given(st.tuples(*(st.floats(low, high) for low, high in LIMITS)).map(np.array))
def test_links_are_where_the_closed_form_says_and_have_mass(q):
    robot = arm_robot()
    upper = Rotation.from_euler("Z", -50, degrees=True) * Rotation.from_euler("YXZ", q[:3])
    elbow = SHOULDER + upper.apply([0, 0, -UPPER_ARM])
    wrist = elbow + (upper * Rotation.from_euler("Y", q[3])).apply([0, 0, -FOREARM])
    points = robot.frame_positions(q[None], ["lower_arm", "wrist"])[0]
    np.testing.assert_allclose(points, [elbow, wrist], rtol=0, atol=1e-12)
    assert np.linalg.eigvalsh(mass_matrix(robot, q)).min() > 1e-4


@pytest.mark.parametrize("joint", TABLE_1)
def test_mass_and_inertia_are_those_of_table_1(joint):
    mass, moments, length = TABLE_1[joint]
    body = MODEL.inertias[MODEL.getJointId(joint)]
    assert body.mass == pytest.approx(mass, abs=1e-12)
    np.testing.assert_allclose(body.inertia, np.diag(moments), atol=1e-12)
    if length is not None:
        np.testing.assert_allclose(body.lever, [0, 0, -length / 2], atol=1e-12)
