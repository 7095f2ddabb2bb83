"""The driver that replays a recorded camera's sightings of landmarks."""

from __future__ import annotations

import numpy as np

from cairn import Out, every, from_ns
from cairn.components.replay.driver import RecordingDriver
from cairn.components.replay.due import Records
from cairn.components.replay.recording import Sighting, Sightings
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from cairn.schemas.std_msgs import Header


class ReplaySightings(RecordingDriver):
    """Replays the camera's sightings of landmarks; the object's number is the subject's."""

    objects: Out[RecognizedObjectArray]

    def on_configure(self) -> None:
        """Read the recording."""
        recording = self.config.open()
        self._unknown: dict[int, int] = {}
        sightings = recording.sightings()
        if sightings is None:
            self.lacks("sightings of landmarks")
            self.records = Records(())
            return
        self._seen: Sightings = sightings
        self.take(recording, sightings.stamps)

    @every(hz=100)
    def replay(self) -> None:
        """Publish what is due."""
        self.publish_due(self._publish)

    def on_deactivate(self) -> None:
        """Tell how many sightings had a barcode that the data set does not list."""
        if self._unknown:
            self.log.info("sightings of unknown barcodes, by barcode: %s", self._unknown)

    def _publish(self, index: int) -> None:
        found = [o for s in self._seen.frames[index] if (o := self._object(s)) is not None]
        if found:
            header = Header(stamp=from_ns(self._seen.stamps[index]), frame_id="base_link")
            self.objects.publish(RecognizedObjectArray(header=header, objects=tuple(found)))

    def _object(self, sighting: Sighting) -> RecognizedObject | None:
        if sighting.object_id is None:
            barcode = sighting.code
            if barcode not in self._unknown:
                self.log.warning("barcode %d is not in Barcodes.dat: ignored", barcode)
            self._unknown[barcode] = self._unknown.get(barcode, 0) + 1
            return None
        covariance = np.array([sighting.range_variance, 0.0, 0.0, sighting.bearing_variance])
        return RecognizedObject(
            object_id=sighting.object_id,
            range=sighting.range_m,
            bearing=sighting.bearing,
            covariance=covariance,
        )
