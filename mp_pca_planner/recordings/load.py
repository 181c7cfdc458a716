# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Loading of recordings as demonstrations; unusable recordings are rejected with a reason.

Each recording is loaded alone, then they are compared: their joints, copies and extents. Some are
loaded again by what the others show.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, replace
from operator import itemgetter
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import as_list, check_number, check_type
from ..exceptions import RecordingError, RobotError, quote_names, unknown_name
from ..robot.model import Robot
from . import bags, cutting
from .cutting import segments_by_hand
from .load_one import LoadTask, load_one
from .reading import LoadOptions, scale_of_calibration
from .recording_set import RecordingSet, Refusal
from .repair.recording import FINGERPRINT_SIZE
from .segmentation import absurd_extent, least_extent_of_set
from .workers import dask_cluster, process_pool

MIN_COMMON = 3
"""Fewer common hashes of fingerprints are no evidence."""

MAX_CHUNK, N_CHUNKS = 16, 64
"""Recordings that are sent to a process together, at most; and so many times they are sent."""

MIN_SHARE = 0.7
"""Share of a recording's runs that another one has, from which on it is a copy or a part of it."""


_OPTIONS = [one.name for one in fields(LoadOptions)]
_OPTIONS += ["jobs", "dask", "executor", "progress", "continuous"]


def load_demonstrations(
    paths: str | Path | Iterable[str | Path],
    *,
    robot: Robot | str | Path | None = None,
    **options: Any,
) -> RecordingSet:
    """Load the demonstrated motions of recordings.

    Parameters
    ----------
    paths :
        Bag files, rosbag2 folders, CSV files, datasets of LeRobot, folders of bags and datasets,
        glob patterns; one of them or several.
    robot : Robot or path of a URDF file, optional
        Its joints are taken, in its order; by default all that every message lists. Of a file,
        the joints that never move in the recordings are left out and noted, such as a gripper's;
        `joints` or a `Robot` choose them all the same.
    **options :
        The most used are these. All others are fields of :class:`LoadOptions`, and `dask`,
        `executor` and `progress` of :func:`.load_recordings`.

        joints : sequence of str
            The joints to take, in this order. All other columns of a CSV file are ignored.
        rename : mapping of str to str
            New names of the joints by the recorded ones, with ``*`` for any text:
            ``{"left_*": "*"}`` strips a prefix.
        degrees : bool
            Whether positions are recorded in degrees. Otherwise they are in rad (or m).
        scale : mapping of str to float, or path
            Factors by joint from recorded values to rad (or m), or a calibration file of LeRobot.
        topic : str
            The topic of a bag, or the column of a LeRobot dataset ('observation.state'). Several,
            separated by commas, are taken together.
        episodes : sequence of int
            The episodes of a LeRobot dataset, or of a CSV file with a column of episodes.
        segment : {'auto', 'none'}
            Whether recordings are cut at rests ('auto'), or each is one motion ('none').
        segments_csv : path
            A table of motions cut by hand, and `labels` the labels to take of it.
        max_gap : float
            Longest time without samples that doesn't cut a recording [s]; 0.5 by default.
        salvage : bool
            Takes what precedes the damage of a damaged bag.
        jobs : int
            Processes that read recordings at the same time; 1 by default.

    Returns
    -------
    recordings : RecordingSet
        A sequence of demonstrations; its `report` says what was repaired, cut and rejected.

    Warns
    -----
    UserWarning
        Once if recordings or motions are not used, and once if joints move absurdly far.

    Raises
    ------
    RecordingError
        If no recording holds a usable motion, or an option is unknown or out of its range.
    RobotError
        If the URDF can't be read or lacks one of the joints.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> bag = mp.write_example_recording("motions.mcap", 6)
    >>> mp.load_demonstrations(bag, robot=mp.config_file("human_arm.urdf"))
    RecordingSet: 11 demonstrations of 1 recording(s), 0 rejected
    """
    check_type(paths, "the paths of recordings", RecordingError, str, Path, Iterable)
    check_type(robot, "robot", RobotError, Robot, str, Path, NoneType)
    several = (
        [paths]
        if isinstance(paths, (str, Path))
        else as_list(paths, "the paths of recordings are needed", RecordingError)
    )
    for option in options.keys() - {*_OPTIONS}:
        raise RecordingError(unknown_name("option of load_demonstrations", option, _OPTIONS, 40))
    joints = options.pop("joints", None)
    options.setdefault("moving_only", joints is None and isinstance(robot, (str, Path)))
    if isinstance(robot, (str, Path)):
        robot = Robot.from_file(robot, joints)
    joints = robot.joint_names if robot else joints
    options = facts_of_robot(robot) | options
    recordings = load_recordings(several, joints=joints, same_joints=True, **options)
    recordings.require_motion()
    for sentence in (recordings.warning, recordings.unit_warning):
        if sentence:
            warnings.warn(sentence, stacklevel=2)
    return recordings


def facts_of_robot(robot: Robot | None) -> dict[str, Any]:
    """The options of :func:`load_recordings` that a robot description decides."""
    if robot is None:
        return {}
    turning = zip(robot.joint_names, robot.continuous, strict=True)
    return {
        "position_limits": robot.position_ranges(),
        "prismatic": robot.prismatic_joints,
        "continuous": tuple(name for name, turns in turning if turns),
    }


def load_recordings(
    paths: str | Path | Iterable[str | Path],
    *,
    jobs: int = 1,
    dask: str | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
    same_joints: bool = False,
    continuous: Collection[str] = (),
    **options: Any,
) -> RecordingSet:
    """Load the demonstrated motions of recordings.

    Parameters
    ----------
    paths :
        Bag files, rosbag2 folders, folders of bags, glob patterns; one of them or several.
    jobs :
        Processes that read recordings at the same time. The result is always the same.
    dask :
        Address of the scheduler of a Dask cluster that reads them instead.
    executor :
        Reads them instead: any executor, whose workers see the recordings at the same paths.
    progress :
        Called with the bytes of recordings done and in all.
    same_joints :
        Takes the joints that more than half of the recordings have from all, and rejects
        recordings that lack some of them. Without such a majority all are taken as they are.
    continuous :
        Joints that turn without end: motions that differ by full turns are put on the same turn.
    **options :
        The fields of :class:`LoadOptions`. `scale` may also be the path of a calibration file of
        LeRobot.

    Raises
    ------
    RecordingError
        If a path holds no recording, the table of segments is malformed, there are no motions of a
        label, or the cluster can't be used. Errors of a single recording are in `refused` instead.
    """
    if isinstance(options.get("scale"), (str, Path)):
        options["scale"] = scale_of_calibration(options["scale"])
    settings = LoadOptions(**options)
    check_number(jobs, "the number of jobs", RecordingError, 1, is_whole=True)
    several = [paths] if isinstance(paths, str | Path) else list(paths)
    found = bags.find_recordings(several)
    if dask is not None or executor is not None:  # its workers have other working directories
        found = tuple(path.absolute() for path in found)
    tasks = _tasks(found, settings)
    workers: AbstractContextManager[Executor | None] = nullcontext(executor)
    if dask is not None:
        workers = dask_cluster(dask)
    elif executor is None and jobs > 1 and len(tasks) > 1:
        workers = process_pool(min(jobs, len(tasks)))
    loaded = [RecordingSet()] * len(tasks)
    with workers as pool:
        _load_all(dict(enumerate(tasks)), loaded, pool, progress)
        refuse_copies(tasks, loaded)
        again = with_joints_of_set(tasks, loaded, same_joints, moving_only=settings.moving_only)
        _load_all(again, loaded, pool, None)
        tasks = [again.get(index, task) for index, task in enumerate(tasks)]
        _load_all(with_extent_of_set(tasks, loaded), loaded, pool, None)
    for name in continuous:
        put_on_one_turn(loaded, name)
    left = bags.files_left_out(several, found)
    if left:
        names = quote_names(str(path) for path in left)
        loaded.append(RecordingSet(notes=(f"files left out, as they are not recordings: {names}",)))
    return RecordingSet.joined(loaded)


def _tasks(found: Sequence[Path], options: LoadOptions) -> list[LoadTask]:
    names = bags.recording_names(found)
    by_hand = segments_by_hand(options.segments_csv, options.labels, names)
    tasks = []
    for path, name in zip(found, names, strict=True):
        rows = None if by_hand is None else tuple(by_hand.get(name, ()))
        # A recording with motions of other labels only has nothing to load.
        if by_hand is None or by_hand.get(name) != []:
            tasks.append(LoadTask(path, name, rows, options))
    return tasks


def _load_all(
    tasks: Mapping[int, LoadTask],
    loaded: list[RecordingSet],
    pool: Executor | None,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Load recordings by index, by the workers of a pool if there is one."""
    sizes = [bags.stored_size(task.path) if progress else 0 for task in tasks.values()]
    done, total = 0, sum(sizes)
    chunk = min(MAX_CHUNK, 1 + len(tasks) // N_CHUNKS)
    ready: Iterable[RecordingSet] = map(load_one, tasks.values())
    if pool is not None:
        ready = pool.map(load_one, tasks.values(), chunksize=chunk)
    try:
        for index, size, found in zip(tasks, sizes, ready, strict=True):
            loaded[index] = found
            done += size
            if progress is not None:
                progress(done, total)
    except BrokenExecutor:
        raise RecordingError(
            "a process that reads recordings died: it was killed, or memory ran out; use fewer "
            "--jobs (jobs in Python)"
        ) from None


def _refuse(loaded: list[RecordingSet], index: int, name: str, reason: str) -> None:
    """Reject a recording after all."""
    loaded[index] = RecordingSet.rejected(Refusal(name, reason))


def refuse_copies(tasks: Sequence[LoadTask], loaded: list[RecordingSet]) -> None:
    """Reject recordings whose samples are those of another one, or a part of them.

    Of a recording with a table of segments, the motions are those that a person chose.
    """
    originals: dict[str, str] = {}
    fingerprints: dict[int, Sequence[int]] = {}
    for index, task in enumerate(tasks):
        for report in loaded[index].reports if task.segments is None else ():
            original = originals.setdefault(report.checksum, task.name)
            if original != task.name:
                _refuse(loaded, index, task.name, f"it is a copy of '{original}', which is used")
            else:
                fingerprints[index] = report.fingerprint
    gone = set[int]()
    for pair, shares in sorted(common_shares(fingerprints).items()):
        if max(shares) >= MIN_SHARE and not gone & set(pair):
            # Of equal ones, the first is kept.
            part, whole = pair if shares[0] > shares[1] + 0.3 else pair[::-1]
            gone.add(part)
            where = f"in '{tasks[whole].name}', which is used"
            if min(shares) < MIN_SHARE:
                reason = f"it is a part of another recording: its samples are also {where}"
            else:
                reason = f"it is a copy in another form: its samples are also {where}"
            _refuse(loaded, part, tasks[part].name, reason)


def common_shares(
    fingerprints: Mapping[int, Sequence[int]],
) -> dict[tuple[int, int], tuple[float, float]]:
    """Shares of the runs of two recordings that the other one has, too.

    Parameters
    ----------
    fingerprints :
        By the index of the recording, increasing.

    Returns
    -------
    :
        By the indices of the recordings, the first one less than the second one.
    """
    owners: dict[int, list[int]] = {}
    for index, own in fingerprints.items():
        for value in own:
            owners.setdefault(value, []).append(index)
    # Of many copies, each is compared with the first ones.
    pairs = Counter(
        (one, other)
        for several in owners.values()
        for i, one in enumerate(several[:4])
        for other in several[i + 1 :]
    )
    shares = {}
    for (one, other), n_common in pairs.items():
        both = fingerprints[one], fingerprints[other]
        # The hashes of a longer recording reach less far.
        reach = min(max(own) if len(own) == FINGERPRINT_SIZE else np.inf for own in both)
        if n_common >= MIN_COMMON:
            first, second = (n_common / sum(x <= reach for x in own) for own in both)
            shares[one, other] = (first, second)
    return shares


def put_on_one_turn(loaded: list[RecordingSet], joint: str) -> None:
    """Shift motions by full turns of a continuous joint, so that their starts are near each other.

    Drivers report angles from -pi to pi, or from 0 after a restart.
    """
    places = [
        (index, k, motion)
        for index, one in enumerate(loaded)
        for k, motion in enumerate(one.demonstrations)
        if joint in motion.joint_names
    ]
    starts = np.array([m.positions[0, m.joint_names.index(joint)] for _, _, m in places])
    for (index, k, motion), turns in zip(places, full_turns(starts), strict=True):
        if turns:
            motions = list(loaded[index].demonstrations)
            positions = motion.positions.copy()
            positions[:, motion.joint_names.index(joint)] += 2.0 * np.pi * turns
            motions[k] = replace(motion, positions=positions)
            reports = [
                replace(x, repairs={**x.repairs, "turns": x.repairs.get("turns", 0) + 1})
                for x in loaded[index].reports
            ]
            loaded[index] = replace(loaded[index], demonstrations=motions, reports=reports)


def full_turns(angles: NDArray[np.float64]) -> list[int]:
    """Numbers of turns that bring angles [rad] into one turn, which begins in their widest gap.

    At least half of the angles stay.
    """
    if angles.size < 2:
        return [0] * angles.size
    ordered = np.sort(np.mod(angles, 2.0 * np.pi))
    gaps = np.diff(ordered, append=ordered[0] + 2.0 * np.pi)
    begin = ordered[gaps.argmax()] + 0.5 * gaps.max()
    turns = -np.floor((angles - begin) / (2.0 * np.pi)).astype(int)
    usual = int(np.percentile(turns, 50, method="lower"))
    return [int(n) - usual for n in turns]


def with_joints_of_set(
    tasks: Sequence[LoadTask], loaded: list[RecordingSet], same_joints: bool, *, moving_only: bool
) -> dict[int, LoadTask]:
    """Recordings to load again with the joints of the set in its order, by index.

    On request, recordings of other joints are rejected. With `moving_only`, joints that move in no
    recording are no joints of the set; unless joints are chosen, those of a gripper never are.
    """
    still = _still_joints(loaded)
    if not moving_only:
        is_chosen = any(task.options.joints for task in tasks)
        still = {x for x in still if "gripper" in x.lower() or "finger" in x.lower()}
        still = set() if is_chosen else still
    orders: dict[frozenset[str], tuple[str, ...]] = {}
    counts = Counter[tuple[str, ...]]()
    for index in range(len(tasks)):
        for report in loaded[index].reports:
            joints = tuple(name for name in report.joint_names if name not in still)
            counts[orders.setdefault(frozenset(joints), joints)] += 1
    common, n_common = max(counts.items(), key=itemgetter(1), default=((), 0))
    is_one_set = same_joints and 2 * n_common > counts.total()
    again: dict[int, LoadTask] = {}
    for index, task in enumerate(tasks):
        used, refused = loaded[index].reports, loaded[index].refused
        for report in used:
            own = set(report.joint_names)
            joints = common if is_one_set else orders[frozenset(own - still)]
            if not own.issuperset(joints):
                _refuse(
                    loaded,
                    index,
                    task.name,
                    f"its joints, {quote_names(report.joint_names)}, are not those of most "
                    f"recordings, {quote_names(common)}: choose joints that all have, or use it "
                    "separately",
                )
            elif joints != report.joint_names:
                again[index] = _with_joints(task, joints, report.joint_names, still)
        for one in refused:
            if is_one_set and not task.options.joints and set(one.joint_names).issuperset(common):
                again[index] = _with_joints(task, common, one.joint_names)
    return again


def _still_joints(loaded: Sequence[RecordingSet]) -> set[str]:
    """The joints that move in no recording that is used."""
    reports = [report for one in loaded for report in one.reports]
    moving = {n for one in reports for n in one.joint_names if n not in one.still_joints}
    return {name for one in reports for name in one.still_joints} - moving


def _with_joints(
    task: LoadTask,
    joints: tuple[str, ...],
    found: Sequence[str],
    still: Collection[str] = (),
) -> LoadTask:
    """A recording with some of its joints, and notes on the others."""
    others = [name for name in found if name not in joints]
    reasons = {
        "they never move": [name for name in others if name in still],
        "most recordings lack them": [name for name in others if name not in still],
    }
    notes = tuple(
        f"joints left out, as {why}: {quote_names(names)}"
        for why, names in reasons.items()
        if names
    )
    return replace(task, options=replace(task.options, joints=joints), notes=notes)


def with_extent_of_set(
    tasks: Sequence[LoadTask], loaded: list[RecordingSet]
) -> dict[int, LoadTask]:
    """Recordings to load again by the extents of all motions, by index.

    Movements of some count as rest relative to the motions of the set. Those of absurdly large
    motions are rejected.
    """
    extents, smallest, largest = list[float](), list[float](), list[float]()
    for index, task in enumerate(tasks):
        reports = loaded[index].reports
        own = [m.extent for x in reports for m in x.motions if task.segments is None]
        extents.extend(own)
        smallest.append(min(own, default=np.inf))
        largest.append(max(own, default=0.0))
    absurd = absurd_extent([*filter(None, largest)])
    for index in np.flatnonzero(np.asarray(largest) > absurd).tolist():
        what = cutting.far_moving("its joints move", largest[index], absurd)
        reason = (
            f"beside the other recordings' motions, {what}; choose the joints, or give "
            "a table of segments if these movements are motions"
        )
        _refuse(loaded, index, tasks[index].name, reason)
        smallest[index] = np.inf
    if not np.isfinite(smallest).any():
        return {}
    least = least_extent_of_set([x for x in extents if x <= absurd])
    small = np.flatnonzero(np.asarray(smallest) <= least).tolist()
    return {index: replace(tasks[index], least_extent=least) for index in small}
