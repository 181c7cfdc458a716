# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Discovery, reading and writing of bag files of ROS 1 and ROS 2."""

from .bag import Bag as Bag
from .bag import Topic as Topic
from .bag import choose_topic as choose_topic
from .bag import open_bag as open_bag
from .discovery import FORMAT_OF_SUFFIX as FORMAT_OF_SUFFIX
from .discovery import RecordingFormat as RecordingFormat
from .discovery import checksum as checksum
from .discovery import files_left_out as files_left_out
from .discovery import find_recordings as find_recordings
from .discovery import recording_format as recording_format
from .discovery import recording_names as recording_names
from .discovery import stored_size as stored_size
from .serialisation import JOINT_STATE as JOINT_STATE
from .serialisation import MARKER_ARRAY as MARKER_ARRAY
from .serialisation import from_cdr as from_cdr
from .serialisation import to_cdr as to_cdr
from .serialisation import write_joint_states as write_joint_states
from .serialisation import write_joint_trajectory as write_joint_trajectory
from .serialisation import write_stored_states as write_stored_states
