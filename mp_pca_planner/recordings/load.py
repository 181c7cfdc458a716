# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Loading of recordings as demonstrations; unusable recordings are rejected with a reason.

Each recording is read and repaired alone. Then they are compared, as copies and by their joints,
and each is cut alone. Last, motions that are small beside those of all others are dropped.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, replace
from itertools import accumulate, compress
from pathlib import Path
from types import NoneType
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import as_list, check_number, check_type
from ..exceptions import (
    PlannerError,
    RecordingError,
    RobotError,
    UnusableRecordingError,
    quote_names,
    unknown_name,
)
from ..renaming import Rename
from ..robot.model import Robot
from . import bags, checks
from .copies import parts_of_others
from .cutting import Segment, cut_recording, no_motion, read_segments
from .demonstration import Demonstration
from .joints_of_set import joints_of_set, notes_on_left_out
from .options import LoadOptions
from .reading import read_recording, scale_of_calibration
from .recording import Recording, Refusal
from .recording_set import RecordingSet
from .segmentation import extent, least_extent_of_set
from .workers import dask_cluster, process_pool

MAX_CHUNK, N_CHUNKS = 16, 64
"""Recordings that are sent to a process together, at most; and so many times they are sent."""

_OPTIONS = [item.name for item in fields(LoadOptions)]
_OPTIONS += ["jobs", "dask", "executor", "progress", "continuous"]


def load_demonstrations(
    paths: str | Path | Iterable[str | Path],
    *,
    robot: Robot | str | Path | None = None,
    joints: Sequence[str] | None = None,
    rename: Rename | None = None,
    degrees: bool = False,
    scale: Mapping[str, float] | str | Path | None = None,
    topic: str | None = None,
    episodes: Sequence[int | str] | None = None,
    segment: Literal["auto", "none"] = "auto",
    cut: Literal["valleys", "rests"] | None = None,
    min_rest: float | None = None,
    segments_csv: str | Path | None = None,
    max_gap: float | None = None,
    salvage: bool = False,
    jobs: int = 1,
    **options: Any,
) -> RecordingSet:
    """Load the demonstrated motions of recordings.

    Parameters
    ----------
    paths :
        Bag files, rosbag2 folders, CSV files, datasets of LeRobot, folders of bags and datasets,
        glob patterns; one of them or several.
    robot : Robot or path of a URDF file, optional
        Its joints are taken, in its order; by default all that every message lists. Joints that
        never move in the recordings are left out and noted, such as a gripper's, unless `joints` or
        a `Robot` choose them.
    joints : sequence of str, optional
        The joints to take, in this order. All other columns of a CSV file are ignored.
    rename : mapping of str to str, optional
        New names of the joints by the recorded ones, with ``*`` for any text:
        ``{"left_*": "*"}`` strips a prefix.
    degrees : bool
        Whether positions are recorded in degrees. Otherwise they are in rad (or m).
    scale : mapping of str to float, or path, optional
        Factors by joint from recorded values to rad (or m), or a calibration file of LeRobot.
        `degrees` doesn't convert these joints: of degrees the factor is ±0.01745.
    topic : str, optional
        The topic of a bag, or the column of a LeRobot dataset ('observation.state'). Several,
        separated by commas, are taken together.
    episodes : sequence of int or str, optional
        The episodes of a LeRobot dataset, or of a CSV file with a column of episodes.
    segment : {'auto', 'none'}
        Whether recordings are cut at rests ('auto'), or each is one motion ('none').
    cut : {'valleys', 'rests'}, optional
        Whether they are cut at valleys of the speed, too. Given, it cuts episodes as well.
    min_rest : float, optional
        Shortest rest that cuts [s], 0.6 by default. Given, it cuts episodes as well.
    segments_csv : path, optional
        A table of motions cut by hand.
    max_gap : float, optional
        Longest time without samples that doesn't cut a recording [s]; 0.5 by default.
    salvage : bool
        Takes what precedes the damage of a damaged bag.
    jobs : int
        Processes that read recordings at the same time.
    **options :
        Other fields of :class:`.LoadOptions`, and `dask`, `executor` and `progress` of
        :func:`.load_recordings`.

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
    for option in options.keys() - {*_OPTIONS}:
        raise RecordingError(unknown_name("option of load_demonstrations", option, _OPTIONS, 40))
    options.setdefault("moving_only", joints is None and isinstance(robot, (str, Path)))
    if isinstance(robot, (str, Path)):
        robot = Robot.from_file(robot, joints)
    if robot is not None and joints is None:
        joints = robot.joint_names
    options = facts_of_robot(robot) | options
    try:
        recordings = load_recordings(
            paths,
            joints=joints,
            rename=rename or {},
            degrees=degrees,
            scale=scale or {},
            topic=topic,
            episodes=episodes,
            segment=segment,
            cut=cut,
            min_rest=min_rest,
            segments_csv=segments_csv,
            max_gap=max_gap,
            salvage=salvage,
            jobs=jobs,
            same_joints=True,
            **options,
        )
    except PlannerError as error:  # whose sentence says it all, without the functions in between
        raise error.with_traceback(None) from None
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
        The fields of :class:`.LoadOptions`. `scale` may also be the path of a calibration file of
        LeRobot.

    Raises
    ------
    RecordingError
        If a path holds no recording, the table of segments is malformed, or the cluster can't be
        used. Errors of a single recording are in `refused` instead.
    """
    if isinstance(options.get("scale"), (str, Path)):
        options["scale"] = scale_of_calibration(options["scale"])
    settings = LoadOptions(**options)
    check_number(jobs, "the number of jobs", RecordingError, 1, is_whole=True)
    several = [paths] if isinstance(paths, str | Path) else as_list(paths, "paths", RecordingError)
    found = bags.find_recordings(several)
    if dask is not None or executor is not None:  # its workers have other working directories
        found = tuple(path.absolute() for path in found)
    names = bags.recording_names(found)
    rows: list[list[Segment] | None] = [None] * len(names)
    if settings.segments_csv is not None:
        by_hand = read_segments(settings.segments_csv, names)
        rows = [by_hand.get(name, []) for name in names]
    tasks = {
        name: ReadTask(path, name, own, settings)
        for path, name, own in zip(found, names, rows, strict=True)
    }
    workers: AbstractContextManager[Executor | None] = nullcontext(executor)
    if dask is not None:
        workers = dask_cluster(dask)
    elif executor is None and jobs > 1 and len(tasks) > 1:
        workers = process_pool(min(jobs, len(tasks)))
    with workers as pool:
        loaded = _read_all(tasks, pool, progress)
        if settings.segments_csv is None:  # else a person chose the motions
            loaded = _without_copies(loaded)
        loaded = _with_joints_of_set(loaded, tasks, pool, same_joints=same_joints)
        cuts = [(one, tasks[name]) for name, one in _used(loaded).items()]
        loaded |= zip(_used(loaded), _each(cut_one, cuts, pool), strict=True)
    for name in continuous:
        loaded = _on_one_turn(loaded, name)
    notes = list[str]()
    if left := bags.files_left_out(several, found):
        text = quote_names(str(path) for path in left)
        notes.append(f"files left out, as they are not recordings: {text}")
    if settings.segments_csv is None:
        loaded = _without_small(loaded)
        motions = _motions(loaded)
        notes += [*checks.kinds(motions), *checks.returns(motions)]
    refused = tuple(one for one in loaded.values() if isinstance(one, Refusal))
    return RecordingSet(tuple(_used(loaded).values()), refused, tuple(notes))


class ReadTask(NamedTuple):
    """A recording to read: its path, its name, its motions if cut by hand, the options."""

    path: Path
    name: str
    rows: Sequence[Segment] | None
    options: LoadOptions


Loaded = dict[str, Recording | Refusal]
"""The recordings of a set by their names, in order."""


def _used(loaded: Loaded) -> dict[str, Recording]:
    return {name: one for name, one in loaded.items() if isinstance(one, Recording)}


def _motions(loaded: Loaded) -> list[Demonstration]:
    return [motion for one in _used(loaded).values() for motion in one.motions]


def _each(
    function: Callable[[Any], Recording | Refusal], tasks: Sequence[Any], pool: Executor | None
) -> Iterator[Recording | Refusal]:
    """The results of a function of each task in order, by the workers of a pool if there is one.

    Raises
    ------
    RecordingError
        If a worker dies.
    """
    if pool is None:
        yield from map(function, tasks)
        return
    try:
        yield from pool.map(function, tasks, chunksize=min(MAX_CHUNK, 1 + len(tasks) // N_CHUNKS))
    except BrokenExecutor:
        raise RecordingError(
            "a process that reads recordings died: it was killed, or memory ran out; use fewer "
            "--jobs (jobs in Python)"
        ) from None


def _read_all(
    tasks: dict[str, ReadTask],
    pool: Executor | None,
    progress: Callable[[int, int], None] | None,
) -> Loaded:
    """Read and repair all recordings."""
    sizes = [bags.stored_size(task.path) if progress else 0 for task in tasks.values()]
    read = _each(read_one, [*tasks.values()], pool)
    loaded: Loaded = {}
    for name, done, one in zip(tasks, accumulate(sizes), read, strict=True):
        loaded[name] = one
        if progress is not None:
            progress(done, sum(sizes))
    return loaded


def read_one(task: ReadTask) -> Recording | Refusal:
    """Read and repair one recording, in this process or another one."""
    path, name, rows, options = task
    if rows == []:
        return Refusal(name, "the table of segments lists no motion of it")
    try:
        return replace(
            read_recording(path, options),
            name=name,
            path=str(path),
            format=bags.recording_format(path),
            checksum=bags.checksum(path),
        )
    except UnusableRecordingError as error:
        return Refusal(name, str(error), error.findings["listed_joints"])
    except RecordingError as error:
        return Refusal(name, str(error))


def _without_copies(loaded: Loaded) -> Loaded:
    """Reject recordings whose samples are those of another one, or a part of them."""
    names, used = list(_used(loaded)), _used(loaded).values()
    copies: Loaded = {}
    for part, whole, is_part in parts_of_others([one.fingerprint for one in used]):
        what = "a part of another recording" if is_part else "a copy"
        reason = f"it is {what}: its samples are also in '{names[whole]}', which is used"
        copies[names[part]] = Refusal(names[part], reason)
    return loaded | copies


def _with_joints_of_set(
    loaded: Loaded, tasks: dict[str, ReadTask], pool: Executor | None, *, same_joints: bool
) -> Loaded:
    """Recordings with the joints of the set, in its order; those without them are rejected.

    A recording is read again if its other joints move: their defects must not cut it.
    """
    options = next(iter(tasks.values())).options
    chosen, reasons = joints_of_set(loaded, options, same_joints=same_joints)
    result, again = dict(loaded), list[ReadTask]()
    for name, joints in chosen.items():
        one, task = loaded[name], tasks[name]
        others = {*one.joint_names} - {*joints}
        if not {*one.joint_names} >= {*joints}:
            reason = (
                f"its joints, {quote_names(one.joint_names)}, are not those of most recordings, "
                f"{quote_names(joints)}: choose joints that all have, or use it separately"
            )
            result[name] = Refusal(name, reason)
        elif isinstance(one, Recording) and others <= {*one.still_joints}:
            result[name] = one.with_joints(joints)
        else:
            again.append(task._replace(options=replace(options, joints=joints)))
    result |= zip((task.name for task in again), _each(read_one, again, pool), strict=True)
    for name, one in _used(result).items():
        left = [x for x in loaded[name].joint_names if x not in chosen[name]]
        result[name] = one.noted(*notes_on_left_out(left, reasons))
    return result


def cut_one(task: tuple[Recording, ReadTask]) -> Recording | Refusal:
    """Cut one recording, in this process or another one."""
    recording, (_, name, rows, options) = task
    try:
        cut = cut_recording(recording, rows, options)
        absurd = checks.absurd(cut.motions, options)
        return cut.noted(*absurd, *checks.beyond_limits(cut.motions, options))
    except RecordingError as error:
        return Refusal(name, str(error))


def _without_small(loaded: Loaded) -> Loaded:
    """Recordings without motions that are rest beside those of all others."""
    every = [extent(motion.positions) for motion in _motions(loaded)]
    least = least_extent_of_set(every) if every else 0.0
    result = dict(loaded)
    for name, one in _used(loaded).items():
        extents = np.array([extent(motion.positions) for motion in one.motions])
        motions = tuple(compress(one.motions, extents > least))
        if motions:
            notes = checks.hesitations(motions)
            n_small = extents.size - len(motions)
            result[name] = replace(one, motions=motions).noted(*notes, rest=n_small)
        else:
            why = "by the extent of the other recordings' motions"
            result[name] = Refusal(name, str(no_motion(extents.tolist(), least, why)))
    return result


def _on_one_turn(loaded: Loaded, joint: str) -> Loaded:
    """Recordings whose motions are shifted by full turns of a continuous joint.

    Their starts are near each other then. Drivers report angles from -pi to pi, or from 0 after a
    restart.
    """
    turning = {name: one for name, one in _used(loaded).items() if joint in one.joint_names}
    columns = {name: one.joint_names.index(joint) for name, one in turning.items()}
    starts = [m.positions[0, columns[name]] for name, x in turning.items() for m in x.motions]
    turns = iter(full_turns(np.array(starts)))
    result = dict(loaded)
    for name, one in turning.items():
        own = np.array([next(turns) for _ in one.motions])
        shift = 2.0 * np.pi * (np.arange(len(one.joint_names)) == columns[name])
        motions = tuple(
            replace(motion, positions=motion.positions + n * shift) if n else motion
            for motion, n in zip(one.motions, own, strict=True)
        )
        result[name] = replace(one, motions=motions).noted(turns=int(np.count_nonzero(own)))
    return result


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
