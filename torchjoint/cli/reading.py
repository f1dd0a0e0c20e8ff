"""Arguments of the commands that read recordings to segment them."""

from __future__ import annotations

from dataclasses import dataclass

import tyro

from torchjoint.cli.arguments import read_topics
from torchjoint.recordings.options import RecordingOptions


@dataclass(frozen=True)
class Reading(RecordingOptions):
    """How recordings are read.

    Attributes:
        topics: for a ROS recording, if several topics fit a role: --topics color=/front/image_raw. The roles are color,
            info, depth, points and odometry.
    """

    topics: tuple[str, ...] = ()  # type: ignore[assignment]

    def options(self) -> RecordingOptions:
        """The options with the topics by their roles."""
        return RecordingOptions(**vars(self) | {"topics": read_topics(self.topics)})


#: The command line's defaults.
AS_IT_IS = Reading()
FlatReading = tyro.conf.OmitArgPrefixes[Reading]
