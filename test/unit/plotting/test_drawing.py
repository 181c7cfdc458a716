# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The pictures: valid files, something in them, and nothing drawn from wrong input."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.plotting import drawing
from mp_pca_planner.plotting.drawing import draw_arm, draw_motion, draw_primitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.robot.limits import JointLimits

image = pytest.importorskip("matplotlib.image", reason="matplotlib is not installed")

PHASES = np.linspace(0.0, 1.0, 51)
FRAMES = ["chest", "upper_arm", "lower_arm", "wrist"]


def pixels(path: Path) -> np.ndarray:
    """Read a PNG, shape (height, width, 4); refuses broken files."""
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    return np.asarray(image.imread(path))


def mask(path: Path, colour: str) -> np.ndarray:
    """Which pixels have a colour, shape (height, width)."""
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.all(np.abs(pixels(path)[:, :, :3] - rgb) < 0.02, axis=2)


def n_pixels(path: Path, colour: str) -> int:
    return int(mask(path, colour).sum())


BLUE, ORANGE, BLACK = "#0072B2", "#D55E00", "#000000"


def names(n_joints: int) -> list[str]:
    return [f"joint{i}" for i in range(n_joints)]


def primitive(n_joints: int = 2, **changes: Any) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    bell = (PHASES * (1 - PHASES))[:, None] * np.ones(n_joints)
    arguments = {
        "joint_names": names(n_joints),
        "phases": PHASES,
        "demonstrations": rng.uniform(0.5, 1.5, (6, 1, 1)) * PHASES[:, None] * np.ones(n_joints),
        "mean": bell,
        "components": np.stack([0.5 * bell, 0.2 * bell]),
        "explained_variance_ratio": [0.9, 0.1],
        "title": "A primitive",
    }
    return arguments | changes


def trajectory(n_joints: int = 2, scale: float = 1.0, with_efforts: bool = True) -> Trajectory:
    t = np.linspace(0.0, 0.8, 41)
    q = scale * np.outer(np.sin(2 * t), 1 + np.arange(n_joints))
    v = np.gradient(q, t, axis=0)
    a = np.gradient(v, t, axis=0)
    return Trajectory(names(n_joints), t, q, v, a, 3 * a if with_efforts else None)


def arm(reach: float = 0.5) -> np.ndarray:
    angles = np.linspace(0.0, 2.0, 30)[:, None] * [0.0, 0.0, 1.0, 1.3]
    lengths = reach * np.arange(4)
    return np.stack([lengths * np.sin(angles), -0.3 * lengths + 0 * angles, -np.cos(angles)], -1)


@pytest.mark.parametrize("n_joints", [1, 4, 7])
def test_picture_of_a_primitive_shows_its_components(tmp_path: Path, n_joints: int) -> None:
    draw_primitive(tmp_path / "p.png", **primitive(n_joints))
    assert n_pixels(tmp_path / "p.png", BLUE) > 200 * n_joints
    assert n_pixels(tmp_path / "p.png", ORANGE) > 100 * n_joints


def test_more_joints_make_a_larger_picture_but_no_wider_one_than_four(tmp_path: Path) -> None:
    shapes = []
    for n_joints in (4, 8):
        path = tmp_path / f"{n_joints}.png"
        draw_primitive(path, **primitive(n_joints))
        shapes.append(pixels(path).shape)
    assert shapes[1][1] == shapes[0][1]
    assert shapes[1][0] > 1.5 * shapes[0][0]


def test_shares_of_variance_may_be_given_per_joint(tmp_path: Path) -> None:
    shares = [[0.9, 0.1], [0.7, 0.2]]
    draw_primitive(tmp_path / "p.png", **primitive(explained_variance_ratio=shares))
    assert n_pixels(tmp_path / "p.png", BLUE) > 400


def test_same_input_gives_the_same_picture(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_primitive(tmp_path / name, **primitive())
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize(
    ("changes", "offender"),
    [
        ({"phases": PHASES[:-1]}, "demonstrations"),
        ({"demonstrations": np.zeros((3, 51))}, "demonstrations"),
        ({"demonstrations": np.zeros((0, 51, 2))}, "at least one demonstration"),
        ({"mean": np.zeros((51, 3))}, "mean shape"),
        ({"mean": np.full((51, 2), np.nan)}, "mean shape"),
        ({"components": np.zeros((51, 2))}, "components"),
        ({"explained_variance_ratio": [1.0]}, "explained variance"),
        ({"explained_variance_ratio": [[0.9, 0.1]]}, "explained variance"),
        ({"joint_names": ["joint0", "joint0"]}, "'joint0' given more than once"),
    ],
)
def test_primitive_of_wrong_shape_is_refused(
    tmp_path: Path, changes: dict[str, Any], offender: str
) -> None:
    with pytest.raises(PlannerError, match=offender):
        draw_primitive(tmp_path / "p.png", **primitive(**changes))
    assert not list(tmp_path.iterdir())


def test_picture_of_a_motion_shows_the_motion_and_what_it_is_compared_with(tmp_path: Path) -> None:
    alone, compared = tmp_path / "alone.png", tmp_path / "compared.png"
    draw_motion(alone, trajectory(), title="A motion")
    draw_motion(
        compared, trajectory(), title="A motion", others={"B-spline": trajectory(scale=0.7)}
    )
    assert n_pixels(alone, BLUE) > 1000
    assert n_pixels(alone, ORANGE) == 0
    assert n_pixels(compared, ORANGE) > 500


def test_efforts_have_panels_only_if_there_are_efforts(tmp_path: Path) -> None:
    for name, with_efforts in (("with.png", True), ("without.png", False)):
        draw_motion(tmp_path / name, trajectory(with_efforts=with_efforts), title="A motion")
    assert pixels(tmp_path / "with.png").shape[0] > pixels(tmp_path / "without.png").shape[0] + 100


def test_limits_are_drawn_where_the_motion_comes_near(tmp_path: Path) -> None:
    def black(max_velocity: float) -> int:
        limits = JointLimits(names(2), {"joint0": {"max_velocity": max_velocity}})
        path = tmp_path / f"{max_velocity}.png"
        draw_motion(path, trajectory(), title="A motion", limits=limits)
        return n_pixels(path, BLACK)

    # The fastest that joint0 gets is 2 rad/s; only the lines of the limit are pure black.
    assert black(2.1) > black(20.0) + 100


def test_prismatic_joints_are_drawn_in_metres(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures: list[Any] = []
    monkeypatch.setattr(drawing, "_save", lambda figure, *_: figures.append(figure))
    motion = trajectory()
    draw_motion(tmp_path / "m.png", motion, title="A motion", prismatic=["joint1"])
    panels = {axes.get_ylabel(): axes.lines[0].get_ydata() for axes in figures[0].axes}
    np.testing.assert_allclose(panels["position [m]"], motion.positions[:, 1])
    np.testing.assert_allclose(panels["position [deg]"], np.rad2deg(motion.positions[:, 0]))
    np.testing.assert_allclose(panels["velocity [m/s]"], motion.velocities[:, 1])


def test_shapes_of_prismatic_joints_are_drawn_in_millimetres(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures: list[Any] = []
    monkeypatch.setattr(drawing, "_save", lambda figure, *_: figures.append(figure))
    shown = primitive(prismatic=["joint1"])
    draw_primitive(tmp_path / "p.png", **shown)
    panels = {axes.get_ylabel(): axes.lines[0].get_ydata() for axes in figures[0].axes}
    first = shown["demonstrations"][0]
    np.testing.assert_allclose(panels["position [mm]"], 1e3 * first[:, 1])
    np.testing.assert_allclose(panels["position [deg]"], np.rad2deg(first[:, 0]))
    assert "shape [mm]" in panels and "shape [deg]" in panels


def test_joint_that_does_not_move_is_drawn(tmp_path: Path) -> None:
    draw_motion(tmp_path / "m.png", trajectory(scale=0.0), title="No motion")
    assert n_pixels(tmp_path / "m.png", BLUE) > 1000


def test_demonstrations_are_drawn_behind_the_motion(tmp_path: Path) -> None:
    motion = trajectory()
    shown = Demonstration(
        names(2),
        motion.times,
        0.5 * motion.positions,
        0.5 * motion.velocities,
        0.5 * motion.accelerations,
        recording="r",
        start_time=0.0,
        end_time=0.8,
    )
    draw_motion(tmp_path / "with.png", motion, title="A motion", demonstrations=[shown])
    draw_motion(tmp_path / "without.png", motion, title="A motion")
    assert not np.array_equal(pixels(tmp_path / "with.png"), pixels(tmp_path / "without.png"))


def test_motions_of_other_joints_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PlannerError, match="'joint0', 'joint1', 'joint2' can't be drawn with"):
        draw_motion(tmp_path / "m.png", trajectory(2), title="", others={"x": trajectory(3)})


def test_two_motions_of_the_same_label_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PlannerError, match="'PCA' given more than once"):
        draw_motion(
            tmp_path / "m.png", trajectory(), title="", label="PCA", others={"PCA": trajectory()}
        )


def test_motion_of_one_point_is_refused(tmp_path: Path) -> None:
    point = Trajectory(["joint0"], [0.0], [[1.0]], [[0.0]], [[0.0]])
    with pytest.raises(PlannerError, match="one point"):
        draw_motion(tmp_path / "m.png", point, title="")


def test_arm_has_a_row_for_each_motion(tmp_path: Path) -> None:
    draw_arm(tmp_path / "one.png", FRAMES, {"PCA": arm()}, title="Arm")
    draw_arm(tmp_path / "two.png", FRAMES, {"B-spline": arm(0.4), "PCA": arm()}, title="Arm")
    assert n_pixels(tmp_path / "one.png", BLUE) > 500
    assert n_pixels(tmp_path / "one.png", ORANGE) == 0
    assert n_pixels(tmp_path / "two.png", ORANGE) > 500


def test_right_arm_is_on_the_left_when_seen_from_the_front(tmp_path: Path) -> None:
    # The end of a still arm that points to the right (-y) is marked by a filled black square.
    chain = np.zeros((5, 2, 3))
    chain[:, 1, 1] = -1.0
    draw_arm(tmp_path / "a.png", ["base", "hand"], {"still": chain}, title="Arm")
    rows, columns = np.nonzero(mask(tmp_path / "a.png", BLUE))
    black = mask(tmp_path / "a.png", BLACK)[rows.min() : rows.max() + 1]
    left_end, right_end = columns.min(), columns[columns < black.shape[1] * 0.6].max()
    assert black[:, left_end - 15 : left_end + 15].sum() > 50
    assert black[:, right_end - 15 : right_end + 15].sum() < 10


def test_arm_without_extent_is_drawn(tmp_path: Path) -> None:
    draw_arm(tmp_path / "a.png", FRAMES, {"point": np.zeros((5, 4, 3))}, title="Arm")
    assert n_pixels(tmp_path / "a.png", BLACK) > 50


def test_arm_keeps_its_proportions(tmp_path: Path) -> None:
    # A square as an arm: as wide as high in the front view.
    square = np.array([[0, 0, 0], [0, -1, 0], [0, -1, 1], [0, 0, 1], [0, 0, 0]], dtype=float)
    draw_arm(tmp_path / "a.png", list("abcde"), {"square": np.stack([square] * 3)}, title="Arm")
    blue = mask(tmp_path / "a.png", BLUE)
    front_view = blue[:, : blue.shape[1] * 6 // 10]
    rows, columns = np.nonzero(front_view)
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=3)


@pytest.mark.parametrize(
    ("motions", "n_ghosts", "offender"),
    [
        ({}, 8, "at least one is needed"),
        ({"PCA": np.zeros((5, 3, 3))}, 8, "points of 'PCA'"),
        ({"PCA": np.zeros((5, 4, 2))}, 8, "points of 'PCA'"),
        ({"PCA": np.zeros((1, 4, 3))}, 8, "1 steps"),
        ({"PCA": np.zeros((5, 4, 3))}, 1, "at least 2 stills"),
    ],
)
def test_arm_of_wrong_shape_is_refused(
    tmp_path: Path, motions: dict[str, np.ndarray], n_ghosts: int, offender: str
) -> None:
    with pytest.raises(PlannerError, match=offender):
        draw_arm(tmp_path / "a.png", FRAMES, motions, title="Arm", n_ghosts=n_ghosts)
    assert not list(tmp_path.iterdir())


def test_existing_file_is_kept_unless_forced(tmp_path: Path) -> None:
    path = tmp_path / "m.png"
    path.write_text("precious", encoding="utf-8")
    with pytest.raises(PlannerError, match="exists already"):
        draw_motion(path, trajectory(), title="A motion")
    assert path.read_text(encoding="utf-8") == "precious"
    draw_motion(path, trajectory(), title="A motion", force=True)
    assert pixels(path).size > 0


def test_other_endings_than_png_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PlannerError, match="pictures are PNG files"):
        draw_motion(tmp_path / "motion.pdf", trajectory(), title="A motion")


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_missing_matplotlib_is_said_in_one_sentence(tmp_path: Path) -> None:
    done = run_python(
        "import sys; sys.modules['matplotlib'] = None\n"
        "from mp_pca_planner.plotting.drawing import draw_arm\n"
        "from mp_pca_planner.exceptions import MissingDependencyError\n"
        "try:\n"
        f"    draw_arm({str(tmp_path / 'a.png')!r}, ['a', 'b'],"
        " {'x': [[[0, 0, 0], [0, 0, 1]]] * 2}, title='')\n"
        "except MissingDependencyError as error:\n"
        "    print(error)"
    )
    assert done.stdout.count("\n") == 1
    assert "'matplotlib', which is not installed" in done.stdout
    assert "mp_pca_planner[plot]" in done.stdout


def test_pyplot_and_its_settings_are_left_alone(tmp_path: Path) -> None:
    done = run_python(
        "import sys\n"
        "from mp_pca_planner.plotting.drawing import draw_arm\n"
        "assert 'matplotlib' not in sys.modules\n"
        f"draw_arm({str(tmp_path / 'a.png')!r}, ['a', 'b'],"
        " {'x': [[[0, 0, 0], [0, 0, 1]]] * 2}, title='')\n"
        "assert 'matplotlib' in sys.modules and 'matplotlib.pyplot' not in sys.modules"
    )
    assert done.returncode == 0, done.stderr
