# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The case study, from motions to the page."""

import csv
import json
from collections import Counter

import numpy as np
import pytest
from support.arm import arm_demonstrations, arm_robot

from mp_pca_planner.cli.main import main
from mp_pca_planner.evaluation.case_study import (
    OURS,
    PAPER,
    choose_motions,
    study,
    variance_shares,
)
from mp_pca_planner.evaluation.case_study_page import tables, verdict
from mp_pca_planner.evaluation.naturalness import BSPLINES, EXPECTED, compare
from mp_pca_planner.exceptions import PrimitiveError
from mp_pca_planner.recordings.demonstration import Demonstration


def labelled(motion: Demonstration, label: str) -> Demonstration:
    return Demonstration(
        motion.joint_names,
        motion.times,
        motion.positions,
        motion.velocities,
        motion.accelerations,
        recording=motion.recording,
        start_time=motion.start_time,
        end_time=motion.end_time,
        label=label,
    )


MOTIONS = [labelled(m, "ab"[i % 2]) for i, m in enumerate(arm_demonstrations()[:12])]


def test_motions_are_chosen_from_all_activities_in_turn():
    labels = ["a"] * 20 + ["b"] * 3 + ["c"] * 7
    motions = [labelled(MOTIONS[0], label) for label in labels]
    chosen = Counter(m.label for m in choose_motions(motions, 12))
    assert chosen == {"a": 5, "b": 3, "c": 4}
    assert len({id(m) for m in choose_motions(motions, 30)}) == 30


@pytest.mark.parametrize("number", [2, 13])
def test_too_many_or_too_few_motions_are_refused(number):
    with pytest.raises(PrimitiveError, match=f"{number} motions can't be chosen.*hold 12"):
        choose_motions(MOTIONS, number)


@pytest.fixture(scope="module")
def found():
    return study(MOTIONS, 6, arm_robot(), "wrist", n_starts=5)


def test_the_arm_raising_motion_lifts_the_hand_most(found):
    robot = arm_robot()
    rises = [
        np.diff(robot.frame_positions(m.positions[[0, -1]], ["wrist"])[:, 0, 2])[0]
        for m in found.motions
    ]
    assert found.raising is found.motions[int(np.argmax(rises))]


def test_all_methods_go_from_end_to_end(found):
    for prediction in found.raised.values():
        np.testing.assert_allclose(
            prediction.positions[[0, -1]], found.raising.positions[[0, -1]], atol=1e-6
        )


def test_our_plan_is_nearer_than_bsplines_which_take_less_effort(found):
    assert found.closer_than_bsplines("time") == 1.0
    predictions = found.raised
    assert predictions[BSPLINES].effort < predictions[OURS].effort


def test_rows_say_which_motions_end_at_rest(found):
    header, rows = tables(found)["table_3"]
    ends = {row[0]: row[header.index("ends")] for row in rows}
    for name, prediction in found.raised.items():
        rates = np.abs(np.diff(prediction.positions, axis=0))[[0, -1]].max()
        assert (ends[name] == "at rest") == (rates < 1e-5), name


def test_efforts_and_times_are_compared_with_the_same_number_of_starts(found):
    header, rows = tables(found)["starts"]
    starts, ends = header.index("starts"), header.index("ends")
    for n in ("1", "5"):
        same = [row for row in rows if row[starts] == n]
        assert {row[ends] for row in same} == {"at rest", "moving"}
        (rest, free, paper) = (dict(zip(header, row, strict=True)) for row in same[:3])
        assert float(rest["effort / same ends"]) == float(free["effort / same ends"]) == 1.0
        ratio = float(paper["effort [N²m²s]"]) / float(free["effort [N²m²s]"])
        assert float(paper["effort / same ends"]) == pytest.approx(ratio, rel=0.05)
    # A total time has the time of every start.
    for prediction in (predictions[PAPER] for predictions in found.held_out.predictions):
        assert prediction.solve_time == pytest.approx(prediction.starts[:, 1].sum())
        assert prediction.effort == prediction.starts[:, 0].min()


def test_shares_are_those_of_the_variance_of_the_angles(found):
    angles = np.array([m.time_normalised(101) for m in found.motions])
    expected = np.linalg.eigvalsh(np.cov(angles[:, :, 0].T))[::-1]
    np.testing.assert_allclose(
        variance_shares(found.components)[0], expected[:4] / expected.sum(), rtol=1e-6
    )
    assert set(found.shares_by_activity) == {"a", "b"}


def test_other_activities_are_those_of_other_labels(found):
    # Without a robot nothing is planned; predictions are the same.
    apart = compare(found.motions, [motion.label for motion in found.motions])
    for quantity in ("time", "path"):
        expected = apart.column(EXPECTED, quantity)
        np.testing.assert_allclose(found.other_activities.column(EXPECTED, quantity), expected)
        assert not np.allclose(found.held_out.column(EXPECTED, quantity), expected)


def test_one_activity_is_not_compared_with_others():
    progress = []
    alone = study(
        MOTIONS[::2],
        3,
        arm_robot(),
        "wrist",
        lambda done, total: progress.append((done, total)),
        n_starts=5,
    )
    assert alone.other_activities is None
    assert progress == [(1, 3), (2, 3), (3, 3)]


def test_the_first_sentence_compares_like_with_like_in_the_numbers_of_the_table(found):
    header, rows = tables(found)["table_3_all_motions"]
    splines, ours = (
        dict(zip(header, row, strict=True))
        for row in rows
        if row[0] in (BSPLINES, "planned, ρ = 0")
    )
    for name in ("ends", "starts"):
        assert splines[name] == ours[name]
    first = verdict(found)[0]
    assert f"{ours['time ratio']} of the time" in first
    assert f"{ours['ratio']} times their effort (paper: 0.648 and 1.85)" in first


def test_generated_motions_are_not_called_those_of_a_person(output):
    for file in ("case_study.html", "case_study.json"):
        text = (output / file).read_text(encoding="utf-8")
        assert "the person's" not in text and "people's" not in text


COMMAND = ("case_study", "--motions", "4", "--starts", "5")


@pytest.fixture(scope="module")
def output(tmp_path_factory, request):
    pytest.importorskip("matplotlib")
    folder = tmp_path_factory.mktemp("study") / "out"
    assert main([*COMMAND, "--output", str(folder), "--json"]) == 0
    return folder


def test_the_command_writes_a_page_that_needs_nothing_else(output):
    page = (output / "case_study.html").read_text(encoding="utf-8")
    assert "Joint angles of generated motions. Pass --recordings" in page
    assert page.count("data:image/png;base64,") == 3
    assert "http" not in page
    assert "<canvas" in page and "requestAnimationFrame" in page
    for heading in ("Table 2", "Table 3", "Naturalness"):
        assert heading in page


def test_the_figures_are_written_beside_it(output):
    facts = json.loads((output / "case_study.json").read_text(encoding="utf-8"))
    assert facts["n_motions"] == 4
    assert facts["table_2"]["elbow"]["paper"][0] == 0.7436
    assert facts["table_3"]["paper"]["PCA"]["effort_cost"] == 9.58805
    for name in ("table_2", "table_3", "table_3_all_motions", "starts", "naturalness"):
        with (output / f"{name}.csv").open(encoding="utf-8") as file:
            header, *rows = csv.reader(file)
        assert rows and all(len(row) == len(header) for row in rows)
    for name in ("figure_2", "figures_3_4", "trade_off"):
        assert (output / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_an_existing_page_is_kept_without_force(output, capsys):
    assert main(["case_study", "--motions", "4", "--output", str(output)]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--segments", "x.csv"], "--segments is for --recordings"),
        (["--recordings", "nowhere"], "nowhere"),
        (["--arm", "upper_arm,hand"], "hand"),
        (["--motions", "1000"], "1000 motions can't be chosen"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, capsys, arguments, message):
    pytest.importorskip("matplotlib")
    assert main(["case_study", *arguments, "--output", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
