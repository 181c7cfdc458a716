# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`build_primitives` with people in the loop: the cuts, the page, several processes."""

import base64
from functools import partial
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from support import commands
from support.bags import reaching, stamped, write_bag

from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.file import load_primitive
from mp_pca_planner.primitives.library import load_primitives
from mp_pca_planner.recordings.load import load_recordings

GOALS = ([0.0, 1.0, 0.2, 0.9], [0.1, 0.8, 0.0], [0.0, 0.7, 0.1, 1.1])
NAMES = ("one", "two & <b>bold", "three")


build = partial(commands.result, "build_primitives")
refusal = partial(commands.refusal, "build_primitives")


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings of 3, 2 and 3 motions, and a broken one."""
    folder = tmp_path_factory.mktemp("bags")
    for name, goals in zip(NAMES, GOALS, strict=True):
        write_bag(folder / name, "mcap", stamped(reaching(goals)))
    (folder / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(99))
    return folder


def arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a primitive file, read by NumPy alone."""
    with np.load(path) as file:
        return {name: file[name] for name in file.files if name != "metadata"}


def used(path: Path) -> list[dict]:
    """The demonstrations that a primitive file lists."""
    return load_primitive(path).metadata["demonstrations"]


def test_written_segments_fed_back_give_the_same_motions_and_labels_part_them(
    bags: Path, tmp_path: Path
) -> None:
    first, second, table = tmp_path / "1.npz", tmp_path / "2.npz", tmp_path / "cuts.csv"
    build(bags, "--output", first, "--write-segments", table)
    header, *rows = table.read_text().splitlines()
    assert len(rows) == 8 and header == "recording,start_time_s,end_time_s,label"
    build(bags, "--output", second, "--segments", table)
    for name, array in arrays(first).items():
        np.testing.assert_array_equal(array, arrays(second)[name])
    labelled = [row + x for row, x in zip(rows, "uvvwuuvw", strict=True)]
    table.write_text("\n".join([header, *labelled]))
    build(bags, "--segments", table, "--output", tmp_path / "labels", "--by", "label")
    for label, n in (("u", 3), ("v", 3), ("w", 2)):
        assert [d["label"] for d in used(tmp_path / f"labels/{label}.npz")] == n * [label]
    table.write_text("\n".join([header, *(f"{row}../u" for row in rows)]))
    words = bags, "--segments", table, "--output", tmp_path / "labels", "--by", "label"
    assert "the label '../u' can't be the name of a file" in refusal(*words)


def test_the_file_is_that_of_python_and_from_processes(bags: Path, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("one.npz", "three.npz", "python.npz")]
    for file, jobs in zip(files, (1, 3), strict=False):
        build(bags, "--output", file, "--name", "p", "--jobs", jobs)
    assert files[0].read_bytes() == files[1].read_bytes()
    build_primitive(load_recordings([bags]).demonstrations, "p").save(files[2])
    for name, array in arrays(files[2]).items():
        np.testing.assert_array_equal(arrays(files[0])[name], array, err_msg=name)


def test_a_primitive_is_built_for_each_label_or_folder(tmp_path: Path) -> None:
    for name, goals in (("near", GOALS[0]), ("far", GOALS[2])):
        (tmp_path / name).mkdir()
        write_bag(tmp_path / name / f"{name}_bag", "mcap", stamped(reaching(goals)))
    table = tmp_path / "segments.csv"
    rows = [f"{name}_bag,0.1,6.9,{name}" for name in ("near", "far")]
    table.write_text("\n".join(["recording,start_time_s,end_time_s,label", *rows]))
    bags = [tmp_path / name for name in ("near", "far")]
    output = tmp_path / "by_folder"
    facts = build(*bags, "--by", "folder", "--output", output)
    assert {one["name"] for one in facts["primitives"]} == {"near", "far"}
    assert load_primitives([output]).names == {"far", "near"}
    assert "exists already" in refusal(*bags, "--by", "folder", "--output", output)
    build(*bags, "--segments", table, "--output", tmp_path / "labels", "--by", "label")
    assert {file.name for file in (tmp_path / "labels").iterdir()} == {"near.npz", "far.npz"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--markers", "/tf"], "--markers needs --robot and --marker-map"),
        (["--report", "page.txt"], "must end in .html"),
        (["--segments", "x.csv", "--cut", "rests"], "are for --segment auto"),
        (["--segment", "none", "--min-rest", "1"], "are for --segment auto"),
        (["--field", "a.b"], "'a.b' needs a topic"),
    ],
)
def test_what_makes_no_sense_is_refused(
    bags: Path, tmp_path: Path, options: list[str], message: str
) -> None:
    assert message in refusal(bags, "--output", tmp_path / "p.npz", *options)
    assert not (tmp_path / "p.npz").exists()


def test_the_shortest_rest_decides_on_the_cuts(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "x", "mcap", stamped(reaching([0.0, 1.0, 0.2], rest=1.0)))
    output = tmp_path / "p.npz"
    assert build(path, "--output", output)["n_motions"] == 2
    # The valley of the speed at the rest would still cut.
    merged = build(path, "--output", output, "--force", "--min-rest", "3", "--cut", "rests")
    assert merged["n_motions"] == 1


def test_damaged_recording_and_longest_gap_through_the_command(tmp_path: Path) -> None:
    messages = stamped(np.tile(reaching([0.1, 1.1, 0.1]), (4, 1)))
    path = write_bag(tmp_path / "x", "mcap", messages[:210] + messages[290:])
    (file,) = path.glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[: int(0.7 * len(content))])
    options = (file, "--output", tmp_path / "p.npz")
    assert "damaged" in refusal(*options)
    found = build(*options, "--salvage")
    assert found["repairs"] == {file.stem: {"gaps": 1, "cut_off": 1}}
    assert "before the damage" in found["notes"][file.stem][0]
    found = build(*options, "--recover", "--max-gap", "1", "--force")
    assert found["repairs"] == {file.stem: {"cut_off": 1}}


class Page(HTMLParser):
    """The tags, the addresses and the text of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.addresses: list[str] = []
        self.text = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.parametrize("coupling", ["arm", "joint"])
def test_report_is_one_page_that_shows_what_was_found(
    bags: Path, tmp_path: Path, coupling: str
) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    path = tmp_path / "page.html"
    output = tmp_path / "p.npz"
    facts = build(bags, "--output", output, "--report", path, "--coupling", coupling)
    page = Page(path)
    # Nothing from outside, nothing that names could smuggle in.
    assert all(address.startswith("data:image/png;base64,") for address in page.addresses)
    assert not {"b", "script", "link"} & page.tags
    assert "url(" not in path.read_text(encoding="utf-8")
    pictures = [base64.b64decode(address.partition(",")[2]) for address in page.addresses]
    assert len(pictures) == 1 + facts["n_recordings"]
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    for name in NAMES:
        assert name in page.text
    assert "broken" in page.text and facts["refused"][0]["reason"] in page.text
    assert "1 recording rejected" in page.text
    assert "paper's arm" not in page.text  # this is another arm
    for report in load_recordings([bags]).reports:
        assert f"rest below {np.rad2deg(report.thresholds.rest):.2f} deg/s" in page.text
