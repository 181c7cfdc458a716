# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`build_primitives` with people in the loop: the cuts, the page, several processes."""

import base64
import csv
import json
import sys
from functools import partial
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.bags import reaching, stamped, write_bag
from support.embedded_bags import FIELD, TOPIC, write_embedded_bag

from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.file import load_primitive
from mp_pca_planner.primitives.library import load_primitives
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.repair import REPAIRS

GOALS = ([0.0, 1.0, 0.2, 0.9], [0.1, 0.8, 0.0], [0.0, 0.7, 0.1, 1.1])
NAMES = ("one", "two & <b>bold", "three")


WORDS = ("build_primitives",)
run = partial(command_line.run, *WORDS)
build = partial(command_line.result, *WORDS)
refusal = partial(command_line.refusal, *WORDS)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings of 3, 2 and 3 motions, and a broken one."""
    folder = tmp_path_factory.mktemp("bags")
    for name, goals in zip(NAMES, GOALS, strict=True):
        write_bag(folder / name, "mcap", stamped(reaching(goals)))
    (folder / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(99))
    return folder


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a primitive file, read by NumPy alone."""
    with np.load(path) as file:
        return {name: file[name] for name in file.files if name != "metadata"}


def spans(path: Path) -> list[tuple]:
    return [
        (d["recording"], d["start_time_s"], d["end_time_s"])
        for d in load_primitive(path).metadata["demonstrations"]
    ]


def test_written_segments_fed_back_give_the_same_motions(bags: Path, tmp_path: Path) -> None:
    first, second, table = tmp_path / "1.npz", tmp_path / "2.npz", tmp_path / "cuts.csv"
    build(bags, "--output", first, "--write-segments", table)
    assert len(rows(table)) == 8 and list(rows(table)[0]) == [
        "recording",
        "start_time_s",
        "end_time_s",
        "label",
    ]
    build(bags, "--output", second, "--segments", table)
    assert spans(first) == spans(second)
    for name, array in arrays(first).items():
        np.testing.assert_array_equal(array, arrays(second)[name])


def test_joint_states_in_a_field_give_the_same_primitive_as_on_a_topic(
    tmp_path: Path, bag_format: str
) -> None:
    plain, embedded = tmp_path / "plain.npz", tmp_path / "embedded.npz"
    states = stamped(reaching(GOALS[0]))
    (tmp_path / "a").mkdir()
    bag = write_bag(tmp_path / "a" / "x", bag_format, states)
    build(bag, "--name", "p", "--output", plain)
    bag = write_embedded_bag(tmp_path / "x", bag_format, states)
    built = build(bag, "--name", "p", "--output", embedded, "--topic", TOPIC, "--field", FIELD)
    assert built["n_motions"] == 3
    expected = arrays(plain)
    for name, array in arrays(embedded).items():
        np.testing.assert_array_equal(array, expected[name])


def test_refusal_of_embedded_joint_states_names_their_field(
    tmp_path: Path, bag_format: str
) -> None:
    bag = write_embedded_bag(tmp_path / "x", bag_format, stamped(reaching(GOALS[0])))
    hint = f"field '{FIELD}' of topic '{TOPIC}'"
    assert hint in refusal(bag, "--output", tmp_path / "p.npz")
    assert hint in refusal(bag, "--output", tmp_path / "p.npz", "--topic", TOPIC)
    assert hint not in refusal(bag, "--output", tmp_path / "p.npz", "--topic", "/other")


def test_notes_are_printed(bags: Path, tmp_path: Path) -> None:
    cut_off = stamped(reaching([0.05, 1.1, 0.2])[:350])
    (tmp_path / "a").mkdir()
    bag = write_bag(tmp_path / "a" / "cut", "mcap", cut_off)
    status, out, _ = run(bag, bags, "--output", tmp_path / "p.npz")
    assert status == 0
    (notes,) = (line for line in out.splitlines() if line.startswith("notes "))
    assert "cut=the messages hold no velocities" in notes
    assert "the recording ends in a motion, which may be cut off there" in notes


def test_recordings_of_a_standing_arm_are_refused_by_name(bags: Path, tmp_path: Path) -> None:
    noise = np.deg2rad(0.05) * np.random.default_rng(0).normal(size=(6000, 2))
    for name in ("standing", "still"):
        write_bag(tmp_path / name, "mcap", stamped(reaching([0.3], rest=60.0) + noise))
    built = build(bags, tmp_path / "standing", "--output", tmp_path / "p.npz")
    assert built["n_motions"] == 8
    assert "standing" in [refused["recording"] for refused in built["refused"]]
    standing = [tmp_path / "standing", tmp_path / "still", "--output", tmp_path / "q.npz"]
    for segment in ("auto", "none"):
        assert "it holds no motion" in refusal(*standing, "--segment", segment)


@pytest.mark.parametrize(
    ("arguments", "lacking"), [(["bag.mcap"], "--output"), (["--output", "x.npz"], "BAG")]
)
def test_what_a_command_lacks_is_named(arguments: list[str], lacking: str) -> None:
    assert f"are required: {lacking}" in refusal_of_parser(*arguments)


def refusal_of_parser(*arguments: str) -> str:
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    return err


def test_a_primitive_is_built_for_each_label_or_folder(tmp_path: Path) -> None:
    for name, goals in (("near", GOALS[0]), ("far", GOALS[2])):
        (tmp_path / name).mkdir()
        write_bag(tmp_path / name / f"{name}_bag", "mcap", stamped(reaching(goals)))
    table = tmp_path / "segments" / "segments.csv"
    table.parent.mkdir()
    rows = [f"{name}_bag,0.1,6.9,{name}" for name in ("near", "far")]
    table.write_text("\n".join(["recording,start_time_s,end_time_s,label", *rows]))
    output = tmp_path / "by_folder"
    bags = [tmp_path / name for name in ("near", "far")]
    status, out, err = run(*bags, "--by", "folder", "--output", output, "--json")
    assert status == 0, err
    assert {one["name"] for one in json.loads(out)["primitives"]} == {"near", "far"}
    assert {file.name for file in output.iterdir()} == {"near.npz", "far.npz"}
    assert load_primitives([output]).names == {"far", "near"}
    status, _, err = run(*bags, "--by", "folder", "--output", output)
    assert status == 2 and "exists already" in err
    labelled = (*bags, "--segments", table, "--output", tmp_path / "by_label")
    status, _, err = run(*labelled, "--by", "label")
    assert status == 0, err
    assert {file.name for file in (tmp_path / "by_label").iterdir()} == {"near.npz", "far.npz"}


def test_a_primitive_without_components_is_warned_of(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    bag = write_bag(tmp_path / "a" / "x", "mcap", stamped(reaching(GOALS[0])))
    status, out, err = run(bag, "--output", tmp_path / "several.npz", "--json")
    assert (status, err) == (0, "") and json.loads(out)["n_components"] > 0
    status, out, err = run(bag, "--segment", "none", "--output", tmp_path / "one.npz", "--json")
    assert status == 0 and json.loads(out)["n_components"] == 0
    (line,) = err.splitlines()
    assert line.startswith(
        "warning: 'one' has no components, because it was learned from one motion"
    )


def test_refusal_of_a_damaged_recording_says_what_may_help(bags: Path, tmp_path: Path) -> None:
    (tmp_path / "cut.mcap").write_bytes(b"\x89MCAP0\r\n")
    found = build(bags, tmp_path / "cut.mcap", "--output", tmp_path / "p.npz")
    reasons = {one["recording"]: one["reason"] for one in found["refused"]}
    assert reasons.keys() == {"broken", "cut"}
    assert reasons["cut"].endswith(
        "recovering it (--recover; salvage=True in Python) reads the part before the damage, if "
        "there is any"
    )
    assert "--recover" not in reasons["broken"]


def test_segments_are_not_overwritten_unless_told(bags: Path, tmp_path: Path) -> None:
    table = tmp_path / "cuts.csv"
    table.write_text("mine", encoding="utf-8")
    options = [bags, "--output", tmp_path / "p.npz", "--write-segments", table]
    assert "exists already" in refusal(*options)
    assert table.read_text(encoding="utf-8") == "mine" and not (tmp_path / "p.npz").exists()
    build(*options, "--force")
    assert len(rows(table)) == 8


def labelled(bags: Path, tmp_path: Path, labels: str = "uvvwuuvw") -> Path:
    """A table of all motions in which each has a letter for a label."""
    table = tmp_path / "labels.csv"
    build(bags, "--output", tmp_path / "all.npz", "--write-segments", table)
    found = rows(table)
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(found[0]))
        writer.writeheader()
        writer.writerows({**row, "label": x} for row, x in zip(found, labels, strict=True))
    return table


def test_label_selects_motions(bags: Path, tmp_path: Path) -> None:
    table = labelled(bags, tmp_path)
    output = tmp_path / "p.npz"
    facts = build(bags, "--segments", table, "--label", "u,w", "--output", output)
    found = [d["label"] for d in load_primitive(output).metadata["demonstrations"]]
    assert facts["n_motions"] == len(found) and sorted(found) == list("uuuww")


def test_recording_without_motions_of_the_label_is_not_refused(bags: Path, tmp_path: Path) -> None:
    table = labelled(bags, tmp_path, "aaabbbcc")
    options = [bags, "--segments", table, "--label", "c", "--output", tmp_path / "p.npz"]
    facts = build(*options)
    assert facts["n_recordings"] == 1
    assert [refused["recording"] for refused in facts["refused"]] == ["broken"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--label", "u"], "labels select motions of a table"),
        (["--segments", "TABLE", "--label", "x"], "valid names: 'u', 'v', 'w'"),
        (["--min-rest", "-1"], "is not a number from"),
        (["--min-motion", "soon"], "is not a number from"),
        (["--min-rest", "1", "--segment", "none"], "are for --segment auto"),
        (["--jobs", "0"], "'0' is not a whole number from 1 to 1024"),
        (["--report", "page.txt"], "must end in .html"),
        (["--write-segments", "cuts.txt"], "must end in .csv"),
    ],
)
def test_what_makes_no_sense_is_refused(
    bags: Path, tmp_path: Path, options: list[str], message: str
) -> None:
    options = [str(labelled(bags, tmp_path)) if x == "TABLE" else x for x in options]
    assert message in refusal(bags, "--output", tmp_path / "p.npz", *options)
    assert not (tmp_path / "p.npz").exists()


def test_shortest_rest_and_motion_decide_on_the_cuts(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "x", "mcap", stamped(reaching([0.0, 1.0, 0.2], rest=1.0)))
    output = tmp_path / "p.npz"
    assert build(path, "--output", output)["n_motions"] == 2
    # The valley of the speed at the rest still cuts, unless a part would be too short.
    merged = build(path, "--output", output, "--force", "--min-rest", "3", "--min-motion", "2")
    assert merged["n_motions"] == 1


def test_thresholds_that_were_used_are_told(bags: Path, tmp_path: Path) -> None:
    thresholds = build(bags, "--output", tmp_path / "p.npz")["thresholds"]
    assert set(thresholds) == set(NAMES)
    assert all(0.0 < found["rest"] < found["moving"] for found in thresholds.values())


def test_processes_give_the_same_bytes_in_the_same_order(bags: Path, tmp_path: Path) -> None:
    files = [tmp_path / f"{jobs}.npz" for jobs in (1, 3)]
    facts = [
        build(bags, "--output", file, "--name", "p", "--jobs", jobs)
        for file, jobs in zip(files, (1, 3), strict=True)
    ]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert facts[0]["refused"] == facts[1]["refused"]
    assert list(facts[0]["repairs"]) == list(facts[1]["repairs"])


def test_the_file_is_that_of_the_primitive_in_python(bags: Path, tmp_path: Path) -> None:
    build(bags, "--output", tmp_path / "p.npz")
    build_primitive(load_recordings([bags]).demonstrations, "p").save(tmp_path / "python.npz")
    ours = arrays(tmp_path / "p.npz")
    for name, array in arrays(tmp_path / "python.npz").items():
        np.testing.assert_array_equal(ours[name], array, err_msg=name)


def test_report_changes_no_byte_of_the_primitive(bags: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    files = [tmp_path / name for name in ("with.npz", "without.npz")]
    build(bags, "--output", files[0], "--name", "p", "--report", tmp_path / "page.html")
    build(bags, "--output", files[1], "--name", "p")
    assert files[0].read_bytes() == files[1].read_bytes()


def test_damaged_recording_and_longest_gap_through_the_command(tmp_path: Path) -> None:
    messages = stamped(np.tile(reaching([0.1, 1.1, 0.1]), (4, 1)))
    path = write_bag(tmp_path / "x", "mcap", messages[:210] + messages[290:])
    (file,) = path.glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[: int(0.7 * len(content))])
    options = (file, "--output", tmp_path / "p.npz")
    assert "damaged" in run(*options)[2]
    found = build(*options, "--salvage")
    assert found["repairs"] == {file.stem: {"gaps": 1, "cut_off": 1}}
    assert "before the damage" in found["notes"][file.stem][0]
    found = build(*options, "--salvage", "--max-gap", "1", "--force")
    assert found["repairs"] == {file.stem: {"cut_off": 1}}
    assert "'a.b' needs a topic" in refusal(*options, "--field", "a.b", "--force")


class Page(HTMLParser):
    """Checks that elements are closed in order; gathers texts, pictures and addresses."""

    VOID = frozenset({"meta", "img", "link", "br"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.text += data


def read_page(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    assert not page.open
    return page


@pytest.mark.parametrize("coupling", ["arm", "joint"])
def test_report_is_one_page_that_shows_what_was_found(
    bags: Path, tmp_path: Path, coupling: str
) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    path = tmp_path / "page.html"
    output = tmp_path / "p.npz"
    facts = build(bags, "--output", output, "--report", path, "--coupling", coupling)
    page = read_page(path)
    # Nothing from outside, nothing that names could smuggle in.
    assert all(address.startswith("data:image/png;base64,") for address in page.addresses)
    assert not {"b", "script", "link"} & set(page.tags)
    assert "url(" not in path.read_text(encoding="utf-8")
    pictures = [base64.b64decode(address.partition(",")[2]) for address in page.addresses]
    assert len(pictures) == 1 + facts["n_recordings"]
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    for name in NAMES:
        assert name in page.text
    assert "broken" in page.text and facts["refused"][0]["reason"] in page.text
    assert "minimum-jerk" in page.text
    assert "paper's arm" not in page.text  # this is another arm
    for report in load_recordings([bags]).reports:
        assert f"rest below {np.rad2deg(report.thresholds.rest):.2f} deg/s" in page.text


def urdf(*types: str) -> str:
    """A chain of joints a, b … of these types."""
    parts = ['<link name="base"/>']
    for parent, name, kind in zip(("base", "to_a"), "ab", types, strict=True):
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="to_{name}"/>'
            '<axis xyz="0 0 1"/><limit effort="9" velocity="9" lower="-3" upper="3"/></joint>'
            f'<link name="to_{name}"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" '
            'iyy="1" iyz="0" izz="1"/></inertial></link>'
        )
    return f'<robot name="r">{"".join(parts)}</robot>'


@pytest.mark.parametrize(
    ("types", "unit"),
    [
        (("revolute", "continuous"), "deg"),
        (("prismatic", "prismatic"), "m"),
        (("prismatic", "revolute"), "rad or m"),
    ],
)
def test_prismatic_joints_are_not_shown_in_degrees(
    bags: Path, tmp_path: Path, types: tuple[str, str], unit: str
) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    (tmp_path / "r.urdf").write_text(urdf(*types), encoding="utf-8")
    output, page = tmp_path / "p.npz", tmp_path / "page.html"
    options = ("--robot", tmp_path / "r.urdf", "--output", output, "--report", page)
    status, _, err = run(bags, *options, "--components", "1")
    assert status == 0, err
    text = page.read_text(encoding="utf-8")
    assert f"reproduced to [{unit} RMS]" in text


def test_report_tells_the_meaning_of_each_repair(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    messages = stamped(reaching([0.0, 1.0, 0.2]))
    messages[50].positions = [np.nan, 0.0]
    path = write_bag(tmp_path / "x", "mcap", messages)
    build(path, "--output", tmp_path / "p.npz", "--report", tmp_path / "page.html")
    page = read_page(tmp_path / "page.html")
    assert page.text.count(REPAIRS["non_finite"]) == 2 and "non_finite: 1" in page.text


def test_page_of_many_recordings_says_what_it_leaves_out(
    bags: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    from mp_pca_planner.plotting import report

    for shown in ("RECORDINGS_DRAWN", "DEMONSTRATIONS_DRAWN", "ROWS"):
        monkeypatch.setattr(report, f"_MAX_{shown}", 2)
    build(bags, "--output", tmp_path / "p.npz", "--report", tmp_path / "page.html")
    page = read_page(tmp_path / "page.html")
    assert "2 of the 8 demonstrations are drawn" in page.text
    assert "2 of the 8 demonstrations are listed" in page.text
    assert "2 of the 3 recordings are drawn" in page.text


def test_missing_matplotlib_is_told_before_any_work(
    bags: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    line = refusal(
        tmp_path / "nowhere", "--output", tmp_path / "p.npz", "--report", tmp_path / "page.html"
    )
    assert "mp_pca_planner[plot]" in line
