# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Generated recordings of markers on a person who raises an arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..recordings.bags import write_markers
from ..recordings.synthetic import continuous_recording, generate_motions
from .marker_joint_states import MarkerSource, place_markers


@dataclass(frozen=True)
class GeneratedMarkers:
    """Motions and measurement of a generated recording.

    Attributes
    ----------
    n_motions : int
        Number of motions; each is followed by the motion back.
    seed : int
        Seed of all random numbers.
    rate : float
        Rate of the measurements [Hz].
    sway, sway_angle : float
        Amplitudes of the standing person's chest about each axis [m, rad].
    sway_rates : tuple of float
        Angular frequencies of the chest about each axis [rad/s].
    noise : float
        Standard deviation of marker positions [m], as of an optical system.
    """

    n_motions: int = 60
    seed: int = 11
    rate: float = 100.0
    sway: float = 0.01
    sway_angle: float = 0.03
    sway_rates: tuple[float, float, float] = (0.7, 1.1, 0.4)
    noise: float = 2e-4

    def write(self, bag: Path, source: MarkerSource) -> None:
        """Write the recording of the markers of a source."""
        motions = generate_motions(self.n_motions, self.seed)
        recording = continuous_recording(motions, self.rate, seed=self.seed)
        names, positions = place_markers(recording.positions, source)
        sway = np.sin(recording.times[:, None] * np.array(self.sway_rates))
        turns = Rotation.from_rotvec(self.sway_angle * sway).as_matrix()
        measured = np.einsum("tij,tmj->tmi", turns, positions) + self.sway * sway[:, None]
        measured += np.random.default_rng(self.seed).normal(0.0, self.noise, measured.shape)
        write_markers(bag, names, recording.stamps, measured, source.topic)
