"""The importer of visual maps from the surveyed landmarks of an MRCLAM data set."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cairn.components.replay.mrclam_files import Dataset
from cairn.schemas.cairn_msgs import VisualMap, VisualObject
from cairn.schemas.std_msgs import Header


def read_landmarks(folder: Path) -> VisualMap:
    """The surveyed map of the data set in `folder`; objects are numbered by subject.

    Raises `RecordingError` for a file that is missing or damaged.
    """
    return VisualMap(
        header=Header(frame_id="map"),
        objects=tuple(
            VisualObject(
                object_id=survey.subject,
                name=f"landmark {survey.subject}",
                x=survey.x,
                y=survey.y,
                covariance=np.array([survey.x_sd**2, 0.0, 0.0, survey.y_sd**2]),
                reliability=0.5,
                state=VisualObject.LIVE,
            )
            for survey in Dataset(folder).landmarks()
        ),
    )
