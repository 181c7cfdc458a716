# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Loading of recordings as demonstrations; unusable recordings are rejected with a reason.

Each recording is read, repaired and cut alone. Then they are compared: their joints, copies and
extents; some are cut again by what the others show.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, fields, replace
from itertools import accumulate
from operator import itemgetter
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import as_list, check_number, check_type
from ..exceptions import (
    RecordingError,
    RobotError,
    UnusableRecordingError,
    listed,
    quote_names,
    unknown_name,
)
from ..lazy import LazyModule
from ..robot.model import Robot
from . import bags, cutting
from .continuity import units_advice
from .copies import parts_of_others
from .demonstration import Demonstration
from .joint_states import Names
from .options import LoadOptions
from .reading import read_recording, scale_of_calibration
from .recording import MarkerResidual, Recording, Segment
from .recording_set import ABSURD, RecordingSet, Refusal
from .repair import repair
from .segmentation import ABSURD_EXTENT, extent, least_extent_of_set
from .workers import dask_cluster, process_pool

hierarchy = LazyModule("scipy.cluster.hierarchy")

MAX_CHUNK, N_CHUNKS = 16, 64
"""Recordings that are sent to a process together, at most; and so many times they are sent."""

# Distance beyond a limit that is no reason for a note, as of soft limits and noise, and one for
# which a recording is rejected: half a turn is beyond any calibration [rad or m].
_LIMIT_TOLERANCE = 0.0175
_ABSURD_EXCESS = 3.14

_GRIPPER = re.compile("gripper|finger|knuckle", re.IGNORECASE)
# Steps in which movements of a gripper and of the arm are compared [s]; speed of a moving arm by
# its greatest; share of its path by which a gripper moves with the arm.
_STEP, _ARM_MOVES, _WITH_ARM = 0.2, 0.1, 0.2


# Fewest motions that are looked at for kinds; most kinds; how many times farther kinds are from
# each other than the parts of one.
_LEAST_OF_KINDS, _MOST_KINDS, _APART = 8, 6, 2.5
# Share of its extent by which a motion that returns ends beside its start; share of such motions.
_RETURNS, _ARE_MOST = 0.1, 0.9
_MOST_COMPARED = 5000  # of 20,000, the distances of all pairs take 1.6 GB

_OPTIONS = [item.name for item in fields(LoadOptions)]
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
        The most used are these. All others are fields of :class:`.LoadOptions`, and `dask`,
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
            `degrees` doesn't convert these joints: of degrees the factor is ±0.01745.
        topic : str
            The topic of a bag, or the column of a LeRobot dataset ('observation.state'). Several,
            separated by commas, are taken together.
        episodes : sequence of int
            The episodes of a LeRobot dataset, or of a CSV file with a column of episodes.
        segment : {'auto', 'none'}
            Whether recordings are cut at rests ('auto'), or each is one motion ('none').
        segments_csv : path
            A table of motions cut by hand.
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
    for option in options.keys() - {*_OPTIONS}:
        raise RecordingError(unknown_name("option of load_demonstrations", option, _OPTIONS, 40))
    joints = options.pop("joints", None)
    options.setdefault("moving_only", joints is None and isinstance(robot, (str, Path)))
    if isinstance(robot, (str, Path)):
        robot = Robot.from_file(robot, joints)
    joints = robot.joint_names if robot else joints
    options = facts_of_robot(robot) | options
    recordings = load_recordings(paths, joints=joints, same_joints=True, **options)
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
    tasks = _tasks(found, settings)
    workers: AbstractContextManager[Executor | None] = nullcontext(executor)
    if dask is not None:
        workers = dask_cluster(dask)
    elif executor is None and jobs > 1 and len(tasks) > 1:
        workers = process_pool(min(jobs, len(tasks)))
    with workers as pool:
        loaded = _without_copies(_load_all(tasks, pool, progress))
        decided = _with_joints_of_set(loaded, settings, same_joints=same_joints)
        again = iter(_load_all([x for x in decided if isinstance(x, LoadTask)], pool, None))
    loaded = [next(again) if isinstance(x, LoadTask) else x for x in decided]
    whole = RecordingSet.joined([one.result for one in _with_extent_of_set(loaded)])
    for name in continuous:
        whole = on_one_turn(whole, name)
    notes = list(whole.notes)
    if left := bags.files_left_out(several, found):
        names = quote_names(str(path) for path in left)
        notes.append(f"files left out, as they are not recordings: {names}")
    if settings.segments_csv is None:
        notes += [*_kinds(whole.demonstrations), *_returns(whole.demonstrations)]
    return replace(whole, notes=tuple(notes))


@dataclass(frozen=True, slots=True)
class LoadTask:
    """A recording to load; its motions, if cut by hand; notes on it."""

    path: Path
    name: str
    segments: tuple[Segment, ...] | None
    options: LoadOptions
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Loaded:
    """The repaired samples of a recording, and its motions; or why there are none."""

    task: LoadTask
    recording: Recording | None
    result: RecordingSet

    @classmethod
    def refused(cls, task: LoadTask, reason: str, joints: Sequence[str] = ()) -> Loaded:
        """The result of a recording that can't be used."""
        refusal = Refusal(task.name, reason, tuple(joints))
        return cls(task, None, RecordingSet(refused=(refusal,)))


def _tasks(found: Sequence[Path], options: LoadOptions) -> list[LoadTask]:
    names = bags.recording_names(found)
    table = options.segments_csv
    by_hand = None if table is None else cutting.read_segments(table, names)
    rows = (None if by_hand is None else tuple(by_hand.get(name, ())) for name in names)
    return [LoadTask(*own, options) for own in zip(found, names, rows, strict=True)]


def _load_all(
    tasks: Sequence[LoadTask],
    pool: Executor | None,
    progress: Callable[[int, int], None] | None,
) -> list[Loaded]:
    """Load recordings, by the workers of a pool if there is one."""
    sizes = [bags.stored_size(task.path) if progress else 0 for task in tasks]
    ready: Iterable[Loaded] = map(load_one, tasks)
    if pool is not None:
        ready = pool.map(load_one, tasks, chunksize=min(MAX_CHUNK, 1 + len(tasks) // N_CHUNKS))
    loaded: list[Loaded] = []
    try:
        for done, one in zip(accumulate(sizes), ready, strict=True):
            loaded.append(one)
            if progress is not None:
                progress(done, sum(sizes))
    except BrokenExecutor:
        raise RecordingError(
            "a process that reads recordings died: it was killed, or memory ran out; use fewer "
            "--jobs (jobs in Python)"
        ) from None
    return loaded


def load_one(task: LoadTask) -> Loaded:
    """Read, repair and cut one recording, in this process or another one."""
    options, residuals = task.options, dict[str, MarkerResidual]()
    try:
        if task.segments == ():
            raise RecordingError("the table of segments lists no motion of it")
        if options.markers is None:
            recording = read_recording(task.path, options)
        else:
            states, residuals = options.markers.joint_states(task.path, salvage=options.salvage)
            recording = repair(states, None, options.max_gap)
    except RecordingError as error:
        facts = error.findings if isinstance(error, UnusableRecordingError) else {}
        return Loaded.refused(task, str(error), facts.get("listed_joints", ()))
    checksum = bags.checksum(task.path)
    noted = recording.noted(*task.notes)
    return cut_one(task, replace(noted, marker_residuals=residuals, checksum=checksum))


def cut_one(task: LoadTask, recording: Recording, least_extent: float = 0.0) -> Loaded:
    """Cut one recording into its motions.

    Parameters
    ----------
    task :
        What is loaded.
    recording :
        Its repaired samples.
    least_extent :
        Smallest extent of a motion by those of all recordings [rad or m].
    """
    try:
        return Loaded(task, recording, _motions_of(task, recording, least_extent))
    except RecordingError as error:
        return Loaded.refused(task, str(error))


def _motions_of(task: LoadTask, recording: Recording, least_extent: float) -> RecordingSet:
    """The motions of a recording, and the report on it.

    Raises
    ------
    RecordingError
        If it holds no motion, or motions absurdly far beyond the limits of the robot.
    """
    options = task.options
    pieces, thresholds = cutting.smoothed(recording)
    if task.segments is not None:
        cuts = [cutting.cut_row(pieces, row) for row in task.segments]
    else:
        is_episode = bool(recording.episodes) and options.segmentation.cut != "rests"
        is_whole = is_episode or options.segment == "none"
        cuts, notes, counts = cutting.cut_motions(
            recording, pieces, thresholds, options.segmentation, least_extent, is_whole=is_whole
        )
        if not recording.episodes:
            whole = cutting.without_cut_off(cuts, pieces, whole=is_whole)
            n_short = 0 if is_whole else cutting.count_short_halves(pieces, thresholds, cuts)
            counts["cut_off"] = len(cuts) - len(whole) + n_short
            cuts = whole
        recording = recording.noted(*notes, repairs=counts)
        if recording.episodes:
            moving = {id(cut.piece) for cut in cuts}
            still = [x.times[0] for x in pieces if id(x) not in moving]
            names = listed([str(recording.episode_at(time + 1e-6)) for time in still])
            notes = (f"episodes without motion: {names}",) if still else ()
            recording = recording.noted(*notes)
    if not cuts:
        raise RecordingError("no motion was found in it")
    motions = tuple(
        cut.demonstration(
            recording.joint_names,
            recording=task.name,
            checksum=recording.checksum,
            episode=recording.episode_at(cut.piece.times[0] + 1e-6),
        )
        for cut in cuts
    )
    report = replace(
        recording,
        name=task.name,
        path=str(task.path),
        format=bags.recording_format(task.path),
        motions=tuple(
            Segment(x.start_time, x.end_time, x.label, extent(x.positions)) for x in motions
        ),
        thresholds=thresholds,
        notes=(*recording.all_notes, *_absurd(motions, options), *_beyond_limits(motions, options)),
    )
    return RecordingSet(motions, (report,))


def _absurd(motions: Sequence[Demonstration], options: LoadOptions) -> tuple[str, ...]:
    """A note if a joint moves absurdly far."""
    ranges = np.max([np.ptp(motion.positions, axis=0) for motion in motions], axis=0)
    if ranges.max() <= ABSURD_EXTENT:
        return ()
    name = motions[0].joint_names[ranges.argmax()]
    advice = units_advice(float(ranges.max()), were_degrees=options.degrees)
    return (f"joint '{name}' moves over {ranges.max():.3g} {ABSURD}: {advice}",)


def _beyond_limits(motions: Sequence[Demonstration], options: LoadOptions) -> tuple[str, ...]:
    """A note if motions are beyond the limits of the robot.

    Raises
    ------
    RecordingError
        If they are absurdly far beyond.
    """
    beyond: list[tuple[float, float, str]] = []
    for motion in motions:
        for name, q in zip(motion.joint_names, motion.positions.T.tolist(), strict=True):
            low, high = options.position_limits.get(name, (-np.inf, np.inf))
            beyond += [(low - min(q), min(q), name), (max(q) - high, max(q), name)]
    excess, position, name = max(beyond, default=(0.0, 0.0, ""))
    if excess <= _LIMIT_TOLERANCE:
        return ()
    text = (
        f"joint '{name}' is at {position:.3g} rad (or m), {excess:.3g} beyond its limit in the "
        "robot description"
    )
    if excess > _ABSURD_EXCESS:
        raise RecordingError(
            f"{text}: positions must be in radians (or m), not in degrees (or mm), and of this "
            "robot"
        )
    return (f"{text}: check that it is of this robot, and its zero position",)


def _without_copies(loaded: Sequence[Loaded]) -> list[Loaded]:
    """Reject recordings whose samples are those of another one, or a part of them.

    Of a recording with a table of segments, the motions are those that a person chose.
    """
    result = list(loaded)
    fingerprints = {
        index: one.recording.fingerprint
        for index, one in enumerate(loaded)
        if one.recording is not None and one.task.segments is None
    }
    for part, whole, is_part in parts_of_others(fingerprints):
        what = "a part of another recording" if is_part else "a copy"
        name = loaded[whole].task.name
        reason = f"it is {what}: its samples are also in '{name}', which is used"
        result[part] = Loaded.refused(loaded[part].task, reason)
    return result


def _with_joints_of_set(
    loaded: Sequence[Loaded], options: LoadOptions, *, same_joints: bool
) -> list[Loaded | LoadTask]:
    """Recordings with the joints of the set in its order, and tasks for those to read again.

    On request, recordings of other joints are rejected. A recording is read again if its other
    joints move: their defects must not cut it.
    """
    recordings = [one.recording for one in loaded if one.recording is not None]
    reasons = _reasons_to_leave_out(recordings, options)
    orders: dict[frozenset[str], Names] = {}
    counts = Counter[Names]()
    for used in recordings:
        joints = tuple(name for name in used.joint_names if name not in reasons)
        counts[orders.setdefault(frozenset(joints), joints)] += 1
    common, n_common = max(counts.items(), key=itemgetter(1), default=((), 0))
    is_one_set = same_joints and 2 * n_common > counts.total()
    decided: list[Loaded | LoadTask] = []
    for one in loaded:
        task, recording = one.task, one.recording
        if recording is None:
            own = next((refusal.joint_names for refusal in one.result.refused), ())
            joints = common
            is_read_again = is_one_set and options.joints is None and set(own) >= set(joints)
        else:
            own = recording.joint_names
            joints = common
            if not is_one_set:
                joints = orders[frozenset(name for name in own if name not in reasons)]
            is_read_again = not set(own) - set(joints) <= set(recording.still_joints)
        notes = _left_out([name for name in own if name not in joints], reasons)
        if recording is not None and not set(own) >= set(joints):
            reason = (
                f"its joints, {quote_names(own)}, are not those of most recordings, "
                f"{quote_names(common)}: choose joints that all have, or use it separately"
            )
            decided.append(Loaded.refused(task, reason))
        elif is_read_again:
            decided.append(replace(task, options=replace(options, joints=joints), notes=notes))
        elif recording is None or joints == own:
            decided.append(one)
        else:
            decided.append(cut_one(task, recording.with_joints(joints).noted(*notes)))
    return decided


def _reasons_to_leave_out(recordings: Sequence[Recording], options: LoadOptions) -> dict[str, str]:
    """Joints that are none of the set, and why.

    With `moving_only` they are those that move in no recording; unless joints are chosen, those of
    a gripper that does not move with the arm always are.
    """
    idle = _idle_grippers(recordings) if options.joints is None else set()
    moving = {n for x in recordings for n in x.joint_names if n not in x.still_joints}
    still = {name for x in recordings for name in x.still_joints} - moving
    if not options.moving_only:
        still = {x for x in still if options.joints is None and _GRIPPER.search(x)}
    return dict.fromkeys(idle, "they move while the arm rests") | dict.fromkeys(
        still, "they never move"
    )


def _idle_grippers(recordings: Sequence[Recording]) -> set[str]:
    """The joints of grippers that move while the other joints rest, by their names and paths."""
    moved, with_arm = defaultdict[str, float](float), defaultdict[str, float](float)
    for recording in recordings:
        of_gripper = np.array([bool(_GRIPPER.search(x)) for x in recording.joint_names])
        if of_gripper.all() or not of_gripper.any():
            continue
        stride = max(round(_STEP * recording.sample_rate), 1)
        paths = np.abs(
            np.vstack([np.diff(x.positions[::stride], axis=0) for x in recording.pieces])
        )
        arm = paths[:, ~of_gripper].sum(axis=1)
        is_moving = arm > _ARM_MOVES * np.quantile(arm, 0.95)
        names = [x for x in recording.joint_names if _GRIPPER.search(x)]
        for name, path in zip(names, paths[:, of_gripper].T, strict=True):
            moved[name] += float(path.sum())
            with_arm[name] += float(path[is_moving].sum())
    return {name for name, path in moved.items() if with_arm[name] < _WITH_ARM * path}


def _kinds(motions: Sequence[Demonstration]) -> tuple[str, ...]:
    """A note if motions are of a few kinds, by clusters of their starts and goals."""
    is_looked_at = _LEAST_OF_KINDS <= len(motions) <= _MOST_COMPARED
    if not is_looked_at or len({motion.joint_names for motion in motions}) != 1:
        return ()
    ends = np.array([motion.positions[[0, -1]] for motion in motions])
    back = ends[:, ::-1]  # a way and its way back are of one kind
    is_back = np.linalg.norm(back - ends[0], axis=(1, 2)) < np.linalg.norm(
        ends - ends[0], axis=(1, 2)
    )
    ends = np.where(is_back[:, None, None], back, ends)
    tree = hierarchy.linkage(ends.reshape(len(ends), -1), "average")
    kinds, greatest = list[int](), _APART
    for k in range(2, _MOST_KINDS + 1):
        sizes = Counter(hierarchy.fcluster(tree, k, "maxclust").tolist()).values()
        apart = tree[-k + 1, 2] / max(tree[-k, 2], 1e-9)
        if len(sizes) == k and min(sizes) > 1 and apart > greatest:
            kinds, greatest = sorted(sizes, reverse=True), apart
    if not kinds:
        return ()
    return (
        f"these look like {len(kinds)} kinds of motions ({', '.join(map(str, kinds))} of them), by "
        "their starts and goals: if they are, label them in a table of segments and learn each "
        "kind by itself (--write-segments, --segments and --by label)",
    )


def _returns(motions: Sequence[Demonstration]) -> tuple[str, ...]:
    """A note if motions end where they start."""
    ways = [np.linalg.norm(x.positions[-1] - x.positions[0]) for x in motions]
    n = sum(way < _RETURNS * extent(x.positions) for way, x in zip(ways, motions, strict=True))
    if not n or n < _ARE_MOST * len(motions):
        return ()
    return (
        f"{n} of {len(motions)} motions end where they start, so a goal elsewhere is unlike them: "
        "cut them at their rests (--cut rests), or by a table (--segments; segments_csv in Python)",
    )


def _left_out(names: Sequence[str], reasons: Mapping[str, str]) -> tuple[str, ...]:
    """Notes on joints that are not taken."""
    several = defaultdict[str, list[str]](list)
    for name in names:
        several[reasons.get(name, "most recordings lack them")].append(name)
    return tuple(
        f"joints left out, as {why}: {quote_names(names)}" for why, names in several.items()
    )


def _with_extent_of_set(loaded: Sequence[Loaded]) -> list[Loaded]:
    """Recordings cut again by the extents of all: some movements are rest beside the others."""
    extents = [
        [m.extent for report in one.result.reports for m in report.motions]
        if one.task.segments is None
        else []
        for one in loaded
    ]
    every = [x for own in extents for x in own]
    least = least_extent_of_set(every) if every else 0.0
    return [
        one
        if one.recording is None or min(own, default=np.inf) > least
        else cut_one(one.task, one.recording, least)
        for one, own in zip(loaded, extents, strict=True)
    ]


def on_one_turn(recordings: RecordingSet, joint: str) -> RecordingSet:
    """Recordings whose motions are shifted by full turns of a continuous joint.

    Their starts are near each other then. Drivers report angles from -pi to pi, or from 0 after a
    restart.
    """
    motions, counts = list(recordings.demonstrations), Counter[str]()
    turning = [
        (k, motion.joint_names.index(joint))
        for k, motion in enumerate(motions)
        if joint in motion.joint_names
    ]
    starts = np.array([motions[k].positions[0, column] for k, column in turning])
    for (k, column), turns in zip(turning, full_turns(starts), strict=True):
        if turns:
            positions = motions[k].positions.copy()
            positions[:, column] += 2.0 * np.pi * turns
            motions[k] = replace(motions[k], positions=positions)
            counts[motions[k].recording] += 1
    reports = tuple(
        x.noted(repairs={"turns": x.repairs.get("turns", 0) + counts[x.name]})
        for x in recordings.reports
    )
    return replace(recordings, demonstrations=tuple(motions), reports=reports)


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
