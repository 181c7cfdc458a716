# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The index of requests against the scores of all primitives, one by one."""

import numpy as np
import pytest

from mp_pca_planner.primitives.in_span import RequestIndex, in_span_score, request_precision

N_JOINTS, N_PRIMITIVES = 3, 2000


def random_requests(spread: float) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """Means and precisions of primitives of a few demonstrations each."""
    rng = np.random.default_rng(3)
    means, precisions = [], []
    for _ in range(N_PRIMITIVES):
        widths = rng.uniform(0.02, 0.5, 2 * N_JOINTS + 1)
        requests = rng.normal(size=(6, widths.size)) * widths
        means.append(requests.mean(axis=0) + spread * rng.normal(size=widths.size))
        precisions.append(request_precision(requests))
    return np.array(means), np.array(precisions), rng


def score(
    request: np.ndarray, mean: np.ndarray, precision: np.ndarray, turning: list[int]
) -> float:
    """Score of one primitive, after the full turns that bring the start nearest to its mean."""
    request = request.copy()
    for joint in turning:
        turn = 2.0 * np.pi * np.round((mean[joint] - request[joint]) / (2.0 * np.pi))
        request[[joint, N_JOINTS + joint]] += turn
    return in_span_score(request, mean, precision)


@pytest.mark.parametrize("spread", [0.1, 3.0])
@pytest.mark.parametrize("turning", [[], [0, 2]])
@pytest.mark.parametrize("n_entries", [2 * N_JOINTS, 2 * N_JOINTS + 1])
def test_the_nearest_are_those_of_the_scores_one_by_one(
    spread: float, turning: list[int], n_entries: int
) -> None:
    means, precisions, rng = random_requests(spread)
    continuous = np.isin(np.arange(N_JOINTS), turning)
    index = RequestIndex(means, precisions, continuous)
    for _ in range(5):
        request = (spread + 0.3) * rng.normal(size=n_entries)
        request[turning] += 2.0 * np.pi * rng.integers(-2, 3, len(turning))
        scores = np.array(
            [score(request, *x, turning) for x in zip(means, precisions, strict=True)]
        )
        expected = np.argsort(scores, kind="stable")[:20]
        found, found_scores = index.nearest(request, 20)
        assert found.tolist() == expected.tolist()
        assert found_scores == pytest.approx(scores[expected], rel=1e-9)
        assert index.scores(request) == pytest.approx(scores, rel=1e-9)
