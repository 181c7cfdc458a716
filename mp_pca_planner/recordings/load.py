# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Loading of recordings as demonstrations; unusable recordings are rejected with a reason.

Each recording is loaded alone, then they are compared: their joints, copies and extents. Some are
loaded again by what the others show.
"""

from __future__ import annotations

import warnings
from array import array
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import fields
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Any

from ..arrays import as_list, check_number, check_type
from ..exceptions import RecordingError, RobotError, unknown_name
from ..files import as_path
from ..robot.model import Robot
from . import bags
from .cache import ReadingCache, key_of
from .comparison import refuse_copies, with_extent_of_set, with_joints_of_set
from .cutting import segments_by_hand
from .load_one import LoadOptions, LoadTask, load_one
from .recording_set import GatheredSets, RecordingSet
from .workers import Outcome, map_in_processes, map_on_cluster

_OPTIONS = [one.name for one in fields(LoadOptions)]
_OPTIONS += ["jobs", "dask", "progress", "known_extents", "resume", "on_disk"]
_DIED = "every process that tried to read it died: it was killed, or memory ran out"


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
        The most used are these. All others are fields of :class:`LoadOptions`, and `resume`,
        `dask`, `progress` and `on_disk` of :func:`.load_recordings`.

        joints : sequence of str
            The joints to take, in this order. All other columns of a CSV file are ignored.
        degrees : bool
            Whether positions are recorded in degrees. Otherwise they are in rad (or m).
        topic : str
            The topic of a bag, or the column of a LeRobot dataset ('observation.state').
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
        Once if recordings or motions are not used, and once if joints move absurdly far or times
        look like milliseconds.

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
    for one in several:
        if not isinstance(one, str):  # an address, or a pattern
            as_path(one, RecordingError)
    for option in options.keys() - {*_OPTIONS}:
        raise RecordingError(unknown_name("option of load_demonstrations", option, _OPTIONS, 40))
    joints = options.pop("joints", None)
    options.setdefault("moving_only", joints is None and isinstance(robot, (str, Path)))
    if isinstance(robot, (str, Path)):
        robot = Robot.from_file(robot, joints)
    joints = robot.joint_names if robot else joints
    options.setdefault("position_limits", position_limits(robot))
    recordings = load_recordings(several, joints=joints, same_joints=True, **options)
    recordings.require_motion()
    for sentence in (recordings.warning, recordings.unit_warning):
        if sentence:
            warnings.warn(sentence, stacklevel=2)
    return recordings


def position_limits(robot: Robot | None) -> dict[str, tuple[float, float]]:
    """Least and largest position of a robot's joints by name [rad or m]; none without a robot."""
    if robot is None:
        return {}
    limits = robot.limits()
    pairs = zip(limits.lower.tolist(), limits.upper.tolist(), strict=True)
    return dict(zip(robot.joint_names, pairs, strict=True))


def load_recordings(
    paths: str | Path | Iterable[str | Path],
    *,
    jobs: int = 1,
    dask: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    known_extents: Sequence[float] = (),
    resume: str | Path | None = None,
    on_disk: bool = False,
    same_joints: bool = False,
    **options: Any,
) -> RecordingSet:
    """Load the demonstrated motions of recordings.

    Parameters
    ----------
    paths :
        Bag files, rosbag2 folders, folders of bags, glob patterns, and URLs of these (s3, gs,
        https, file); one of them or several.
    jobs :
        Processes that read recordings at the same time. The result is always the same.
    dask :
        Address of the scheduler of a Dask cluster that reads them instead, see
        :func:`.workers.map_on_cluster`. The result is the same.
    progress :
        Called with the bytes of recordings done and in all.
    known_extents :
        Extents of further motions of the set, which are not loaded again [rad or m].
    resume :
        A folder that keeps what was read of each recording, so that an interrupted run continues
        where it was. What it holds is not read again.
    on_disk :
        Holds demonstrations, reports and summaries in temporary files: they can be iterated over,
        and each takes little memory.
    same_joints :
        Takes the joints that more than half of the recordings have from all, and rejects
        recordings that lack some of them. Without such a majority all are taken as they are.
    **options :
        The fields of :class:`LoadOptions`.

    Raises
    ------
    RecordingError
        If a path holds no recording, the table of segments is malformed, there are no motions of a
        label, or the cluster can't be used. Errors of a single recording are in `refused` instead.
    """
    settings = LoadOptions(**options)
    check_number(jobs, "the number of jobs", RecordingError, 1, is_whole=True)
    tasks = _tasks(bags.find_recordings(paths), settings, is_absolute=dask is not None)
    kept = ReadingCache() if resume is None else ReadingCache.resumed(resume)
    loaded = GatheredSets(len(tasks), on_disk=on_disk)
    _load_all(dict(enumerate(tasks)), loaded, kept, jobs, dask, progress)
    refuse_copies(tasks, loaded)
    again = with_joints_of_set(tasks, loaded, same_joints, moving_only=settings.moving_only)
    _load_all(again, loaded, kept, jobs, dask, None)
    tasks = [again.get(index, task) for index, task in enumerate(tasks)]
    again = with_extent_of_set(tasks, loaded, known_extents)
    _load_all(again, loaded, kept, jobs, dask, None)
    settings.cache.prune()
    return loaded.result()


def _tasks(
    found: Sequence[bags.Recording], options: LoadOptions, *, is_absolute: bool
) -> list[LoadTask]:
    names = bags.recording_names(found)
    by_hand = segments_by_hand(options.segments_csv, options.labels, names)
    tasks = []
    for path, name in zip(found, names, strict=True):
        rows = None if by_hand is None else tuple(by_hand.get(name, ()))
        # A recording with motions of other labels only has nothing to load.
        if by_hand is None or by_hand.get(name) != []:
            if is_absolute and isinstance(path, Path):
                path = path.absolute()
            tasks.append(LoadTask(path, name, rows, options))
    return tasks


def _load_all(
    tasks: Mapping[int, LoadTask],
    loaded: GatheredSets,
    kept: ReadingCache,
    jobs: int,
    dask: str | None,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Load recordings by index."""
    indices, left = array("q", tasks), array("q")
    sizes = array("q", [bags.stored_size(x.path) if progress else 0 for x in tasks.values()])
    total, done = sum(sizes), 0
    for position, index in enumerate(indices):
        found = kept.value(_key(tasks[index])) if kept.folder else None
        if isinstance(found, RecordingSet):
            loaded[index] = found
            done += sizes[position]
        else:
            left.append(position)

    def within(item: int, share: float) -> None:
        if progress is not None:
            progress(done + int(share * sizes[left[item]]), total)

    with closing(_outcomes([tasks[indices[i]] for i in left], jobs, dask, within)) as ready:
        for item, result in ready:
            index = indices[left[item]]
            if result is None:
                loaded.refuse(index, tasks[index].name, _DIED)
            else:
                loaded[index] = result
            # What was refused is tried again: the reason may have been the network.
            if kept.folder and result is not None and not result.refused:
                kept.keep(_key(tasks[index]), result)
            done += sizes[left[item]]
            within(item, 0.0)


def _key(task: LoadTask) -> str:
    return key_of(task, bags.stored_state(task.path))


def _outcomes(
    tasks: Sequence[LoadTask], jobs: int, dask: str | None, within: Callable[[int, float], None]
) -> Generator[Outcome, None, None]:
    if dask is not None and tasks:
        yield from map_on_cluster(load_one, tasks, dask, _local_path)
    elif jobs > 1 and len(tasks) > 1:
        yield from map_in_processes(load_one, tasks, jobs)
    else:
        for index, task in enumerate(tasks):
            yield index, load_one(task, partial(within, index))


def _local_path(task: LoadTask) -> str:
    return str(task.path) if isinstance(task.path, Path) else ""
