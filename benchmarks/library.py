# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Kinds that `build_library` finds in a heap of labelled motions, beside their labels.

The motions of several folders are put into one heap. Prints the adjusted Rand index of kinds and
labels, once with each outlier as a kind of its own, and that of shuffled labels (mean and largest
of 100). Prints also the RMS error in path [deg] of motions that are left out and predicted from
their ends and duration by primitives of the other motions: of the same label, of the same kind, or
of all pooled; the kind of an outlier is the one with the least in-span score. "chosen": the
primitive is chosen by the in-span score, as a planner does that knows neither label nor kind. The
last table has the errors by which `build_library` decides, of motions that are left out before the
kinds are found, with labels and without.

    python benchmarks/library.py FOLDER... [--segments FILE.csv] [--json]

The table of segments is that of the first folder; other recordings have their name as label.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from tables import Table, benchmark_parser, show

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.primitives.build import PrimitiveOptions, build_from_statistics
from mp_pca_planner.primitives.build_library import adjusted_rand_index
from mp_pca_planner.primitives.differences import FINE_PHASES, differences, expected_motion
from mp_pca_planner.primitives.in_span import in_span_score
from mp_pca_planner.primitives.kinds import OUTLIER, KindOptions, choose_kinds, find_kinds
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.load import load_recordings

OPTIONS = PrimitiveOptions()
GROUPINGS = ("label", "kind", "pooled")


def main() -> None:
    """Print the indices and a table of errors."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("folders", nargs="+", metavar="FOLDER")
    parser.add_argument("--segments", metavar="FILE.csv")
    arguments = parser.parse_args()
    heaps: dict[tuple[str, ...], list[Demonstration]] = {}
    for i, folder in enumerate(arguments.folders):
        for motion in _motions(folder, None if i else arguments.segments):
            heaps.setdefault(motion.joint_names, []).append(motion)
    labels, kinds, errors, choices = [], [], [], []
    for motions in heaps.values():
        statistics = MotionStatistics.of(motions, OPTIONS)
        found = find_kinds(statistics, OPTIONS.n_phases).assigned
        offset = max(kinds, default=OUTLIER) + 1
        kinds += [int(k) if k == OUTLIER else int(k) + offset for k in found]
        labels += [motion.label for motion in motions]
        errors.append(_errors(motions, statistics, found))
        unlabelled = MotionStatistics.of([replace(x, label="") for x in motions], OPTIONS)
        name = f"{len(motions)} motions of set {len(errors)}"
        choices.append([name, *_choice(statistics)])
        choices.append([f"{name}, without labels", *_choice(unlabelled)])
    tables = {"Agreement": _agreement(labels, kinds)}
    tables["Left-out error in path [deg]"] = _error_table(kinds, errors)
    header = ["", "kinds", "outliers", "kind known", "chosen", "pooled", "kept"]
    tables["Error by which kinds are kept [deg]"] = header, choices
    show(tables, as_json=arguments.json)


def _choice(statistics: MotionStatistics) -> list[str]:
    """Errors with kinds and with one primitive, and which is kept."""
    _, errors = choose_kinds(statistics, OPTIONS.n_phases, KindOptions())
    if errors is None:
        return ["1", "0", "", "", "", "one primitive"]
    numbers = np.rad2deg([errors.known, errors.chosen, errors.pooled])
    kept = "one primitive" if errors.one_is_best else "kinds"
    counts = str(errors.n_kinds), str(errors.n_outliers)
    return [*counts, *(f"{x:.2f}" for x in numbers), kept]


def _motions(folder: str, segments: str | None) -> list[Demonstration]:
    found = load_recordings(folder, segments_csv=segments).demonstrations
    return [replace(x, label=x.label or x.recording) for x in found]


def _errors(
    motions: Sequence[Demonstration], statistics: MotionStatistics, kinds: Sequence[int]
) -> FloatArray:
    """Errors in path [rad], shape (n_motions, 2, 3): given or chosen, by grouping."""
    groupings = [[x.label for x in motions], list(kinds), [0] * len(motions)]
    whole = [
        {name: _primitive(statistics, _members(groups, name)) for name in set(groups) - {OUTLIER}}
        for groups in groupings
    ]
    rows = []
    for i, motion in enumerate(motions):
        truth = motion.time_normalised(FINE_PHASES.size)
        columns = []
        for groups, primitives in zip(groupings, whole, strict=True):
            others = dict(primitives)
            if groups[i] != OUTLIER:
                left = _members(groups, groups[i]) - {i}
                others.pop(groups[i])
                if left:
                    others[groups[i]] = _primitive(statistics, left)
            chosen = min(others.values(), key=lambda x, m=motion: _score(x, m))
            pair = (others.get(groups[i], chosen), chosen)
            columns.append([differences(expected_motion(x, motion), truth)[2] for x in pair])
        rows.append(np.transpose(columns))
    return np.array(rows)


def _members(groups: Sequence[object], name: object) -> set[int]:
    return {i for i, group in enumerate(groups) if group == name}


def _primitive(statistics: MotionStatistics, members: set[int]) -> MovementPrimitive:
    return build_from_statistics(statistics.chosen(sorted(members)), "others", OPTIONS)


def _score(primitive: MovementPrimitive, motion: Demonstration) -> float:
    ends = motion.positions[[0, -1]].ravel()
    request = np.append(ends, np.log(motion.duration))
    return in_span_score(request, primitive.model.mean, primitive.model.request_precision)


def _agreement(labels: Sequence[str], kinds: Sequence[int]) -> Table:
    rng = np.random.default_rng(1)
    own = [k if k != OUTLIER else -1 - i for i, k in enumerate(kinds)]
    inside = [i for i, k in enumerate(kinds) if k != OUTLIER]
    shuffled = [adjusted_rand_index(rng.permutation(labels).tolist(), own) for _ in range(100)]
    in_kinds = adjusted_rand_index([labels[i] for i in inside], [kinds[i] for i in inside])
    counts = [len(labels), len(set(labels)), len(set(kinds) - {OUTLIER}), len(labels) - len(inside)]
    indices = [adjusted_rand_index(labels, own), in_kinds, np.mean(shuffled), max(shuffled)]
    header = ["motions", "labels", "kinds", "outliers", "adjusted Rand index", "of those in kinds"]
    header += ["of shuffled labels", "at most"]
    return header, [[*map(str, counts), *(f"{x:.3f}" for x in indices)]]


def _error_table(kinds: Sequence[int], errors: Sequence[FloatArray]) -> Table:
    parts = {f"{len(x)} motions of set {i}": x for i, x in enumerate(errors, start=1)}
    everything = np.concatenate(errors)
    parts["all motions in kinds"] = everything[np.not_equal(kinds, OUTLIER)]
    parts["all motions"] = everything
    rows = []
    for name, squares in ((name, np.mean(x**2, axis=0)) for name, x in parts.items()):
        (given, chosen) = np.rad2deg(np.sqrt(squares))
        ratio = given[1] / given[0]
        rows.append([name, *(f"{x:.2f}" for x in (*given, ratio, *chosen[:2]))])
    header = ["", "label", "kind", "pooled", "kind / label", "label chosen", "kind chosen"]
    return header, rows


if __name__ == "__main__":
    main()
