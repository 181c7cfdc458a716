# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Kinds of motions in mixed recordings, and their names.

A motion and its return along the same path are of one kind, as in the conditional model. Motions
are therefore compared by features that reversal in time does not change. A tree of Ward's method
(Ward, J. Am. Stat. Assoc. 58, 1963) is cut from its leaves to its root. A branch is divided into
kinds if two conditions hold:

- The features are denser: the kinds' evidence, as normal distributions with their shares of the
  motions, is higher than that of one kind (Heller and Ghahramani, "Bayesian hierarchical
  clustering", ICML 2005; the shares as in the integrated completed likelihood of Biernacki, Celeux
  and Govaert, IEEE PAMI 22, 2000).
- Motions that are left out are predicted about as well as before, by the kind that a planner
  chooses from their ends and duration.

The first one alone divides similar motions into too many kinds of few demonstrations. The second
one alone divides without end: the kinds were found with the motions that are then left out.

A planner is not given the kind of a motion: it chooses the primitive with the least in-span score
of the request. Where kinds share ends and durations, it often chooses a wrong one, and one
primitive of all motions predicts better. :func:`choose_kinds` compares both on motions that are
left out before their kinds are found.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import ClusterNode, linkage, to_tree
from scipy.special import multigammaln
from scipy.stats import multivariate_t

from ..arrays import FloatArray, check_number, empty_rows, release, row_blocks
from ..exceptions import PrimitiveError
from ..robot.model import Robot
from .in_span import RequestIndex, left_out_scores, request_precision
from .motion_statistics import MotionStatistics, thinned
from .pca import components_for_share, fit_components
from .prediction import left_out_squares

OUTLIER = -1
"""Kind of motions that belong to none."""

# At most this share of the motions is left out at once, and this number in all.
_SHARE = 0.1
_MAX_LEFT_OUT = 200

Indices = NDArray[np.intp]

# Names. A kind has a direction or a label if this share of its motions has it.
_MAJORITY = 0.75
# Shortest distance from the middle of all kinds at which a kind is called low or high, near or far
# [m or rad], and the same as a share of the largest such distance.
_LEAST_APART, _LEAST_SHARE = 0.05, 0.35
# Length of a name, which leaves space for a number and for the ending of a file.
_MAX_BYTES = 150


@dataclass(frozen=True)
class KindOptions:
    """Options of finding kinds.

    Attributes
    ----------
    min_motions : int
        Least number of motions of a kind; fewer are outliers.
    shape_weight, duration_weight : float
        Weights of the shapes and of the logarithms of the durations, relative to end points [rad].
    variance : float
        Share of the variance of the features that is compared.
    prior_variance : float
        Usual variance within a kind, as a share of that of all motions.
    prior_weight : float
        Weight of the mean of all motions in that of a kind, in motions.
    tolerance : float
        Largest mean square error of left-out motions after a division, relative to before.
    max_left_out : int
        Largest number of motions of a branch that are left out.
    explained : float
        Least probability, relative to the best kind, with which another one explains a motion.
    max_clustered : int
        Largest number of motions in the tree; the others join the kinds that are found. The time
        and the memory of the tree grow with the square of their number.
    """

    min_motions: int = 3
    shape_weight: float = 2.0
    duration_weight: float = 0.3
    variance: float = 0.9
    prior_variance: float = 0.3
    prior_weight: float = 0.05
    tolerance: float = 1.1
    max_left_out: int = 200
    explained: float = 0.1
    max_clustered: int = 2000


_OPTIONS = KindOptions()


@dataclass(frozen=True, eq=False)
class Kinds:
    """Motions by kind.

    Attributes
    ----------
    assigned : array of int, shape (n_demonstrations,)
        Kind of each motion, from 0 for the largest kind; `OUTLIER` for none.
    explained_by : array of bool, shape (n_demonstrations, n_kinds)
        Whether each kind explains each motion; none explains an outlier.
    positions : array, shape (n_demonstrations, 2)
        First two principal components of the features, a map of the motions.
    """

    assigned: Indices
    explained_by: NDArray[np.bool_]
    positions: FloatArray

    def members(self, kind: int) -> Indices:
        """Indices of the motions of a kind, a whole number; `OUTLIER` for those of none."""
        check_number(kind, "a kind", PrimitiveError, OUTLIER, is_whole=True)
        return np.flatnonzero(self.assigned == kind)


_Group = tuple[int, FloatArray, FloatArray]
"""Number, mean and scatter of feature vectors."""


class _Division(NamedTuple):
    """A branch of the tree, divided or not.

    Attributes
    ----------
    evidence : float
        Logarithm of the evidence of the parts.
    kinds : tuple of sequences of int
        Motions of each kind.
    squares, scores : array, shape (n_kinds, n_motions)
        Squared errors and in-span scores of all motions, left out of the kind.
    """

    evidence: float
    kinds: tuple[Sequence[int], ...]
    squares: FloatArray
    scores: FloatArray

    def chosen(self, members: Indices) -> FloatArray:
        """Squared errors of motions by the kind that a planner chooses, shape (n_members,)."""
        best = self.scores[:, members].argmin(axis=0)
        return np.asarray(self.squares[best, members])


def find_kinds(
    statistics: MotionStatistics, n_phases: int, options: KindOptions = _OPTIONS
) -> Kinds:
    """Find the kinds of motions.

    Parameters
    ----------
    statistics : MotionStatistics
        Of the motions, in any order.
    n_phases : int
        Phases at which their shapes were sampled.
    options : KindOptions
        Options.
    """
    raw = _raw_features(statistics, n_phases, options)
    features = _features(raw, options)
    step = -(-len(features) // options.max_clustered)
    sample = np.lexsort(features.T[::-1])[::step]
    clustered = raw[sample]
    release(raw)
    links = linkage(clustered, "ward") if len(sample) > 1 else None
    tree = _Tree(features[sample], statistics.chosen(sample), options)
    kinds = sorted((np.sort(sample[x]) for x in tree.kinds(links)), key=lambda x: (-len(x), x[0]))
    densities = np.empty((len(features), len(kinds)))
    for i, members in enumerate(kinds):
        densities[:, i] = tree.density(features, features[members], len(sample))
    assigned = densities.argmax(axis=1)
    # As probable as a motion of a kind of its own.
    alone = tree.density(features, features[:0], len(sample))
    assigned[densities.max(axis=1) < alone] = OUTLIER
    assigned[sample] = OUTLIER
    for i, members in enumerate(kinds):
        assigned[members] = i
    least = densities.max(axis=1, keepdims=True) + np.log(options.explained)
    explained_by = (densities >= least) & (assigned != OUTLIER)[:, None]
    return Kinds(assigned, explained_by, features[:, :2])


def _features(raw: FloatArray, options: KindOptions) -> FloatArray:
    """Principal components that have the share of the variance to be compared; at least two."""
    components = fit_components(raw)
    n_found = len(components.components)
    n_compared = max(2, components_for_share(components, options.variance)) if n_found else 0
    first = components.truncated(n_compared)
    found = np.concatenate([first.transform(block) for (block,) in row_blocks(raw)])
    return np.pad(found, ((0, 0), (0, max(0, 2 - found.shape[1]))))


def _raw_features(statistics: MotionStatistics, n_phases: int, options: KindOptions) -> FloatArray:
    """Features that reversal in time does not change, shape (n_demonstrations, n_features)."""
    n_joints, n_functions = statistics.shapes.shape[1:]
    size = n_joints * (2 + (n_functions + 1) // 2) + 1
    raw = empty_rows(len(statistics.durations), {"raw": (np.float64, (size,))})["raw"]
    for part, (rows,) in zip(statistics.blocks(), row_blocks(raw), strict=True):
        rows[:] = _raw_feature_rows(part, n_phases, options)
    return raw


def _raw_feature_rows(
    statistics: MotionStatistics, n_phases: int, options: KindOptions
) -> FloatArray:
    start, goal = statistics.boundary_states[:, 0], statistics.boundary_states[:, 3]
    # The functions of the shapes are alternately even and odd.
    even = statistics.shapes[:, :, ::2].reshape(len(start), -1) / np.sqrt(n_phases)
    return np.column_stack(
        [
            (start + goal) / np.sqrt(2.0),
            np.abs(goal - start) / np.sqrt(2.0),
            options.shape_weight * even,
            options.duration_weight * np.log(statistics.durations),
        ]
    )


class _Tree:
    """Motions in a tree, and the kinds into which it is cut.

    Parameters
    ----------
    features : array, shape (n_motions, n_features)
        Their features, with mean zero.
    statistics : MotionStatistics
        Their statistics.
    options : KindOptions
        Options.
    """

    def __init__(
        self, features: FloatArray, statistics: MotionStatistics, options: KindOptions
    ) -> None:
        self._features, self._options = features, options
        self._requests, self._shapes = statistics.requests(), statistics.both_shapes()
        self._remainders = statistics.shape_remainders.sum(axis=1)
        variances = features.var(axis=0)
        floor = 1e-6 * float(variances.max(initial=0.0)) + 1e-12
        self._prior = options.prior_variance * np.diag(variances + floor)
        self._freedom = features.shape[1] + 2.0
        # The same order in all branches, so that whole and parts leave out the same motions.
        self._order = np.random.default_rng(0).permutation(len(features))

    def kinds(self, links: FloatArray | None) -> tuple[Sequence[int], ...]:
        """Motions of each kind, given the links of the tree of all; None for one motion."""
        if links is None or len(self._features) < 2 * self._options.min_motions:
            return (list(range(len(self._features))),)
        return self._divided(to_tree(links)).kinds

    def density(self, features: FloatArray, members: FloatArray, n_motions: int) -> FloatArray:
        """Logarithms of the density that a kind predicts, times its share of the motions."""
        n, weight = len(members), self._options.prior_weight + len(members)
        center, scatter = np.zeros(len(self._prior)), self._prior
        if n:
            group = _, mean, _ = _group(members)
            center = n * mean / weight
            scatter = self._posterior_scatter(group)
        freedom = self._freedom + n - len(center) + 1.0
        shape = scatter * (weight + 1.0) / (weight * freedom)
        log_share = np.log(max(n, 1) / n_motions)
        return np.asarray(multivariate_t(center, shape, df=freedom).logpdf(features) + log_share)

    def _posterior_scatter(self, group: _Group) -> FloatArray:
        (n, mean, scatter), weight = group, self._options.prior_weight
        pull = weight * n / (weight + n)
        return self._prior + scatter + pull * np.outer(mean, mean)

    def _evidence(self, group: _Group) -> float:
        """Logarithm of the evidence of one kind, up to a term that all divisions share.

        Murphy, "Machine Learning: A Probabilistic Perspective", 2012, equation 5.29.
        """
        (n, _, _), size, weight = group, len(self._prior), self._options.prior_weight
        after = self._freedom + n
        log_ratio = multigammaln(after / 2.0, size) - multigammaln(self._freedom / 2.0, size)
        log_before = np.linalg.slogdet(self._prior)[1]
        log_after = np.linalg.slogdet(self._posterior_scatter(group))[1]
        shrinkage = np.log(weight / (weight + n))
        halves = self._freedom * log_before - after * log_after + size * shrinkage
        return float(log_ratio + halves / 2.0)

    def _divided(self, root: ClusterNode) -> _Division:
        """Divide the tree into the kinds that meet both conditions."""
        evidences = self._evidences(root)
        reached, waiting = [], [root]
        while waiting:
            node = waiting.pop()
            reached.append(node)
            own, densest = evidences[node.id]
            # Without a denser division below, it stays whole.
            if node.count >= self._options.min_motions and densest > own:
                waiting += [node.left, node.right]
        divisions: dict[int, _Division] = {}
        for node in reversed(reached):
            divisions[node.id] = self._division(node, evidences[node.id][0], divisions)
        return divisions[root.id]

    def _evidences(self, root: ClusterNode) -> dict[int, tuple[float, float]]:
        """Evidence of every branch as one kind, and of its densest division, by identifier."""
        groups: dict[int, _Group] = {}
        found: dict[int, tuple[float, float]] = {}
        for node in _from_leaves(root):
            if node.is_leaf():
                groups[node.id] = _group(self._features[[node.id]])
                own = parts = self._evidence(groups[node.id])
            else:
                groups[node.id] = _joined(groups.pop(node.left.id), groups.pop(node.right.id))
                own = self._evidence(groups[node.id])
                parts = found[node.left.id][1] + found[node.right.id][1] + _log_shares(node)
            found[node.id] = own, max(own, parts)
        return found

    def _division(
        self, node: ClusterNode, evidence: float, below: Mapping[int, _Division]
    ) -> _Division:
        """The best division of a branch, given those of its branches, if they matter."""
        members = node.pre_order()
        if node.count < self._options.min_motions:
            nothing = np.empty((0, len(self._features)))
            return _Division(evidence, (), nothing, nothing)
        whole = _Division(evidence, (members,), *self._judged(members))
        if node.is_leaf() or node.left.id not in below:
            return whole
        first, second = below[node.left.id], below[node.right.id]
        parts = _Division(
            first.evidence + second.evidence + _log_shares(node),
            first.kinds + second.kinds,
            np.concatenate([first.squares, second.squares]),
            np.concatenate([first.scores, second.scores]),
        )
        if not parts.kinds or parts.evidence <= evidence:
            return whole
        inside = np.concatenate(parts.kinds)  # without outliers
        largest = self._options.tolerance * whole.squares[0, inside].sum()
        return parts if parts.chosen(inside).sum() < largest else whole

    def _judged(self, members: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Squared errors and in-span scores of all motions for a kind, see `_Division`."""
        first = np.argsort(self._order[members])[: self._options.max_left_out]
        used = np.sort(np.asarray(members)[first])
        squares = left_out_squares(self._requests, self._shapes, used) + self._remainders
        return squares[None], left_out_scores(self._requests, used)[None]


def _from_leaves(root: ClusterNode) -> list[ClusterNode]:
    """All nodes of a tree, each after those below it, without recursion."""
    found, waiting = [], [root]
    while waiting:
        node = waiting.pop()
        found.append(node)
        if not node.is_leaf():
            waiting += [node.left, node.right]
    return found[::-1]


def _log_shares(node: ClusterNode) -> float:
    """Logarithm of the probability of the division of motions, from the shares of both parts."""
    counts = np.array([node.left.count, node.right.count])
    return float(counts @ np.log(counts / counts.sum()))


def _group(features: FloatArray) -> _Group:
    mean = features.mean(axis=0)
    deviations = features - mean
    return len(features), mean, deviations.T @ deviations


def _joined(first: _Group, second: _Group) -> _Group:
    (n_first, mean, scatter), (n_second, other_mean, other_scatter) = first, second
    n = n_first + n_second
    apart = other_mean - mean
    between = n_first * n_second / n * np.outer(apart, apart)
    return n, mean + n_second / n * apart, scatter + other_scatter + between


@dataclass(frozen=True)
class KindErrors:
    """RMS errors in path of left-out motions, with kinds and with one primitive [rad or m].

    Attributes
    ----------
    n_kinds, n_outliers : int
        Number of kinds, and of motions that belong to none.
    known : float
        Each motion is predicted by the primitive of its kind.
    chosen : float
        Each is predicted by the primitive that a planner chooses from its ends and its duration.
    pooled : float
        Each is predicted by one primitive of all motions.
    """

    n_kinds: int
    n_outliers: int
    known: float
    chosen: float
    pooled: float

    @property
    def one_is_best(self) -> bool:
        """Whether one primitive of all motions predicts better than a planner chooses."""
        return self.pooled <= self.chosen


def choose_kinds(
    statistics: MotionStatistics, n_phases: int, options: KindOptions
) -> tuple[Kinds, KindErrors | None]:
    """Find kinds of motions, and keep them if a planner predicts better with them.

    Parameters
    ----------
    statistics, n_phases, options :
        See :func:`.find_kinds`.

    Returns
    -------
    kinds : Kinds
        The kinds, or a single kind of all motions.
    errors : KindErrors or None
        Errors with the kinds that were found, kept or not; None if all motions are of one kind.
    """
    found = find_kinds(statistics, n_phases, options)
    if not found.assigned.any():
        return found, None
    errors = _left_out_errors(statistics, n_phases, options, found)
    if errors.one_is_best:
        whole = np.zeros_like(found.assigned)
        found = replace(found, assigned=whole, explained_by=whole[:, None] == 0)
    return found, errors


def _left_out_errors(
    statistics: MotionStatistics, n_phases: int, options: KindOptions, kinds: Kinds
) -> KindErrors:
    requests = statistics.requests()
    # The same folds whatever the order of the motions.
    order = np.lexsort(requests.T[::-1])
    left_out = order[:: -(-len(order) // _MAX_LEFT_OUT)]
    n_folds = min(ceil(len(left_out) / (_SHARE * len(order))), len(left_out))
    squares = []
    for tests in (left_out[first::n_folds] for first in range(n_folds)):
        rest = np.setdiff1d(np.arange(len(requests)), tests)
        refound = find_kinds(statistics.chosen(rest), n_phases, options)
        members = [rest[refound.members(k)] for k in range(refound.assigned.max() + 1)]
        by_kind = np.array([_squares(statistics, x, tests) for x in members])
        chosen = by_kind[_nearest(requests, members, tests), np.arange(len(tests))]
        pooled, known = _squares(statistics, rest, tests), chosen.copy()
        for kind in set(kinds.assigned[tests].tolist()) - {OUTLIER}:
            here = kinds.assigned[tests] == kind
            others = np.setdiff1d(kinds.members(kind), tests)
            if len(others):
                known[here] = _squares(statistics, others, tests[here])
        squares.append([known, chosen, pooled])
    means = np.concatenate(squares, axis=1).mean(axis=1)
    rms = np.sqrt(means / (n_phases * len(statistics.joint_names)))
    n_outliers = int(np.sum(kinds.assigned == OUTLIER))
    return KindErrors(int(kinds.assigned.max()) + 1, n_outliers, *map(float, rms))


def _squares(statistics: MotionStatistics, used: Indices, tests: Indices) -> FloatArray:
    """Squared errors of some motions that are predicted by others, shape (n_tests,)."""
    used = used[thinned(statistics.chosen(used).requests())]
    both, n = statistics.chosen(np.concatenate([used, tests])), len(used)
    requests, shapes = both.requests(), both.both_shapes()
    squares = left_out_squares(requests, shapes, np.arange(n), both.labels()[:n])
    return np.asarray(squares[n:] + both.shape_remainders[n:].sum(axis=1))


def _nearest(requests: FloatArray, members: list[Indices], tests: Indices) -> Indices:
    """The kind with the least in-span score for each of some requests, shape (n_tests,)."""
    index = RequestIndex(
        np.array([requests[x].mean(axis=0) for x in members]),
        np.array([request_precision(requests[x]) for x in members]),
        np.zeros(requests.shape[1] // 2, dtype=bool),
    )
    return np.array([index.scores(requests[i]).argmin() for i in tests])


# Both ends of the axes of a base frame: x forward, y to the left, z up (REP 103).
_DIRECTIONS = (
    ("back", "forward", "back_and_forth"),
    ("right", "left", "left_and_right"),
    ("down", "up", "up_and_down"),
)
_REGIONS = (("near", "far"), ("at_right", "at_left"), ("low", "high"))
_REACH = "reach"
_FALLS, _RISES, _BOTH = range(3)


@dataclass(frozen=True)
class _Space:
    """The coordinates in which motions are described, and the words for them.

    Attributes
    ----------
    place : callable
        Coordinates of configurations of shape (n, n_joints), shape (n, n_coordinates).
    region : callable
        Where these coordinates are, of the same shape.
    directions, regions : sequence of tuple of str
        Words for each coordinate.
    middle : array, shape (n_coordinates,)
        1 where regions are relative to the mean of all kinds, 0 where they are absolute.
    verb : tuple of str
        What a motion without a label is called first.
    """

    place: Callable[[FloatArray], FloatArray]
    region: Callable[[FloatArray], FloatArray]
    directions: Sequence[tuple[str, str, str]]
    regions: Sequence[tuple[str, str]]
    middle: FloatArray
    verb: tuple[str, ...]


def kind_names(
    kinds: Sequence[MotionStatistics], taken: Collection[str] = (), robot: Robot | None = None
) -> list[str]:
    """Distinct names of kinds, each valid as the name of a file, such as ``reach_left_low``.

    A kind is called by the label of its motions. Otherwise its name says where the end effector
    goes and, if that differs between the kinds, where it ends, both in the robot's base frame.
    Names that would be equal get further words, then numbers.

    Parameters
    ----------
    kinds :
        The statistics of the motions of each kind.
    taken :
        Names not to use.
    robot : Robot, optional
        The robot. Without it, names say which joint moves most, and which way.
    """
    if not kinds:
        return []
    described = _described(kinds, robot)
    lengths = [n for _, n in described]
    while True:
        names = [_name_of(words[:n]) for (words, _), n in zip(described, lengths, strict=True)]
        counts = Counter([*names, *taken])
        longer = [
            min(n + (counts[name] > 1), len(words))
            for name, n, (words, _) in zip(names, lengths, described, strict=True)
        ]
        if longer == lengths:
            return _numbered(names, taken)
        lengths = longer


def plain_name(words: str) -> str:
    """Words as the name of a file: everything but letters and digits is replaced."""
    return re.sub(r"\W+", "_", words).strip("_")[:60] or "motions"


def _name_of(words: Sequence[str]) -> str:
    """Words as a name, cut where it would be too long for a file."""
    name = "_".join(dict.fromkeys(map(plain_name, words)))
    return name.encode()[:_MAX_BYTES].decode(errors="ignore")


def _space(joint_names: Sequence[str], robot: Robot | None) -> _Space:
    if robot is None:
        directions = [(f"{x}_minus", f"{x}_plus", f"{x}_both_ways") for x in joint_names]
        regions = [(f"{x}_low", f"{x}_high") for x in joint_names]
        middle = np.ones(len(joint_names))
        return _Space(lambda q: q, lambda x: x, directions, regions, middle, ())
    arm = robot.with_joints(joint_names)
    tip = [arm.end_effector]

    def reach(x: FloatArray) -> FloatArray:
        """Distance from the axis of the base in place of x."""
        return np.column_stack([np.hypot(x[:, 0], x[:, 1]), x[:, 1:]])

    def place(q: FloatArray) -> FloatArray:
        return np.asarray(arm.frame_positions(q, tip)[:, 0])

    middle = np.array([1.0, 0.0, 1.0])  # left and right are sides of the base
    return _Space(place, reach, _DIRECTIONS, _REGIONS, middle, (_REACH,))


def _described(
    kinds: Sequence[MotionStatistics], robot: Robot | None
) -> list[tuple[tuple[str, ...], int]]:
    """Words for each kind, the most telling ones first, and how many of them a name needs."""
    n = len(kinds[0].joint_names)
    space = _space(kinds[0].joint_names, robot)
    requests = [x.requests() for x in kinds]
    ends = [(space.place(rows[:, :n]), space.place(rows[:, n : 2 * n])) for rows in requests]
    moves = [_direction(goal - start) for start, goal in ends]
    last = [
        space.region(np.concatenate([start, goal]) if side == _BOTH else goal).mean(axis=0)
        for (start, goal), (_, side) in zip(ends, moves, strict=True)
    ]
    apart = np.array(last) - space.middle * np.mean(last, axis=0)
    least = np.maximum(_LEAST_APART, _LEAST_SHARE * np.abs(apart).max(axis=0))
    usual = np.median(np.concatenate([x.durations for x in kinds]))
    described = []
    for kind, (axis, side), offsets in zip(kinds, moves, apart, strict=True):
        notable = [i for i in np.argsort(-np.abs(offsets)) if abs(offsets[i]) > least[i]]
        # The direction nearly says where a kind ends along it.
        notable.sort(key=lambda i: bool(i == axis))
        places = [space.regions[i][int(offsets[i] > 0.0)] for i in notable]
        pace = "slow" if np.median(kind.durations) > usual else "fast"
        motion = (*space.verb, space.directions[axis][side])
        label = _label(kind)
        # Joints have long names: where they are is said of kinds that move the same one only.
        n_words = 1 if label else len(motion) + bool(robot and notable and notable[0] != axis)
        words = (label, motion[-1]) if label else motion
        described.append(((*words, *places, pace), n_words))
    return described


def _label(kind: MotionStatistics) -> str:
    """The label that most motions have, if any."""
    counts = Counter(motion.label for motion in kind.motions)
    label, count = counts.most_common(1)[0]
    return label if count >= _MAJORITY * len(kind.motions) else ""


def _direction(displacements: FloatArray) -> tuple[int, int]:
    """The coordinate that changes most, and whether it falls, rises, or does both in turns."""
    axis = int(np.abs(displacements).sum(axis=0).argmax())
    positive = float(np.mean(displacements[:, axis] > 0.0))
    if positive >= _MAJORITY:
        return axis, _RISES
    return axis, _FALLS if positive <= 1.0 - _MAJORITY else _BOTH


def _numbered(names: Sequence[str], taken: Collection[str]) -> list[str]:
    found: list[str] = []
    for name in names:
        number, free = 1, name
        while free in found or free in taken:
            number += 1
            free = f"{name}_{number}"
        found.append(free)
    return found
