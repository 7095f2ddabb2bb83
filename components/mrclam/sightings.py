"""The driver that replays the camera's sightings of one robot's recording."""

from __future__ import annotations

import numpy as np

from cairn.clock import from_ns
from cairn.component.handlers import every
from cairn.component.ports import Out
from components.mrclam.dataset import ROBOTS, Dataset, Sightings
from components.mrclam.noise import range_bearing_variance
from components.mrclam.recording import RecordingDriver
from components.mrclam.replay import Records, nanoseconds
from schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from schemas.std_msgs import Header


class MrclamSightings(RecordingDriver):
    """Replays the camera's sightings of landmarks; the object's number is the subject's."""

    objects: Out[RecognizedObjectArray]

    def on_configure(self) -> None:
        """Read the recording and join sightings of one time to one message."""
        dataset = Dataset(self.config.dataset)
        self._subjects = dataset.subjects()
        self._seen: Sightings = dataset.sightings(self.config.robot)
        stamps = nanoseconds(self._seen.time)
        begins = [k for k, stamp in enumerate(stamps) if k == 0 or stamp != stamps[k - 1]]
        self._frames = [
            range(a, b) for a, b in zip(begins, [*begins[1:], len(stamps)], strict=True)
        ]
        self._stamps = [stamps[k] for k in begins]
        self.records = Records(self._stamps)
        self._unknown: dict[int, int] = {}

    @every(hz=100)
    def replay(self) -> None:
        """Publish what is due."""
        self.publish_due(self._publish)

    def on_deactivate(self) -> None:
        """Tell how many sightings had a barcode that the data set does not list."""
        if self._unknown:
            self.log.info("sightings of unknown barcodes, by barcode: %s", self._unknown)

    def _publish(self, index: int) -> None:
        found = [o for k in self._frames[index] if (o := self._object(k)) is not None]
        if found:
            header = Header(stamp=from_ns(self._stamps[index]), frame_id="base_link")
            self.objects.publish(RecognizedObjectArray(header=header, objects=tuple(found)))

    def _object(self, index: int) -> RecognizedObject | None:
        barcode = int(self._seen.barcode[index])
        subject = self._subjects.get(barcode)
        if subject is None:
            if barcode not in self._unknown:
                self.log.warning("barcode %d is not in Barcodes.dat: ignored", barcode)
            self._unknown[barcode] = self._unknown.get(barcode, 0) + 1
            return None
        if subject in ROBOTS:
            return None
        reach = float(self._seen.range_m[index])
        range_variance, bearing_variance = range_bearing_variance(reach)
        return RecognizedObject(
            object_id=subject,
            range=reach,
            bearing=float(self._seen.bearing[index]),
            covariance=np.array([range_variance, 0.0, 0.0, bearing_variance]),
        )
