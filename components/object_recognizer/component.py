"""The component ObjectRecognizer: from camera images to sightings of taught objects."""

from __future__ import annotations

import cv2
import numpy as np

from cairn import (
    RELIABLE,
    SECOND,
    SENSOR,
    CairnError,
    Component,
    Config,
    In,
    Out,
    ParameterRejected,
    RateLimitedLog,
    every,
    from_ns,
    on,
    to_ns,
)
from cairn.components.object_recognizer.agreement import Agreement
from cairn.components.object_recognizer.bearings import NOWHERE, Field, Place, field_of, place_of
from cairn.components.object_recognizer.cameras import Cameras, cameras_of, same_camera
from cairn.components.object_recognizer.condition import Standstill, blindness, shows_little
from cairn.components.object_recognizer.config import ObjectRecognizerConfig
from cairn.components.object_recognizer.known import KnownObjects
from cairn.components.object_recognizer.pairing import Pair, Pairing
from cairn.components.object_recognizer.sighting import Sighting, sighted, without_wrong_twins
from cairn.components.object_recognizer.stereo_check import swapped, unlike
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from cairn.vision.features import Features, extract
from cairn.vision.images import Gray, gray_of
from cairn.vision.map_file import MapFileError

# A camera that is silent, or shows the same, for so long is complained of.
_SILENCE_NS = 2 * SECOND
_STANDSTILL_NS = SECOND


class ObjectRecognizer(Component):
    """Recognizes taught objects in the images of a camera or of a stereo pair.

    Tells of every new image which objects are in it, where they are from the robot, and where it
    could have recognized any. Corners are those in the rectified left image.
    """

    config: ObjectRecognizerConfig
    # The newest alone: what came while another image was looked at is old.
    left_image: In[Image] = In(qos=SENSOR.with_depth(1))
    right_image: In[Image] = In(qos=SENSOR.with_depth(1), optional=True)
    left_info: In[CameraInfo] = In(qos=SENSOR)
    right_info: In[CameraInfo] = In(qos=SENSOR, optional=True)
    objects: Out[RecognizedObjectArray] = Out(qos=RELIABLE.with_depth(200))

    def on_configure(self) -> None:
        """Read what was taught, so that a damaged file is told of before anything moves."""
        cv2.setNumThreads(self.config.threads)
        self._known = KnownObjects(self.config.map_file)
        self._tell_known()
        self._warnings = RateLimitedLog(self.log)
        self._infos: dict[str, CameraInfo | None] = {"left": None, "right": None}
        self._cameras: Cameras | None = None

    def on_activate(self) -> None:
        """Wait for images."""
        self._pairing = Pairing(stereo=self.config.stereo)
        self._standstills = {"left": Standstill(), "right": Standstill()}
        self._agreement = Agreement()
        self._right_came = False
        self._last_left: int | None = None

    def on_parameters(self, new: Config) -> None:
        """All but the file, the number of cameras and threads may be changed while it runs."""
        for name in ("map_file", "stereo", "threads"):
            if getattr(new, name) != getattr(self.config, name):
                raise ParameterRejected(f"{name} is taken when the recognizer is configured")

    @on("left_info")
    def know_left(self, info: CameraInfo) -> None:
        """Take the left camera's calibration."""
        self._know("left", info)

    @on("right_info")
    def know_right(self, info: CameraInfo) -> None:
        """Take the right camera's calibration."""
        self._know("right", info)

    @on("left_image")
    def see_left(self, image: Image) -> None:
        """Look at a left image, or keep it until its right one has come."""
        now = self.clock.now()
        self._last_left = now
        if not self._is_new("left", image, self.left_image.topic):
            return
        self._look_at(self._pairing.take_left(to_ns(image.header.stamp), image, now))
        if self._pairing.right_is_missing(now) and not self._standstills["right"].lasts:
            remedy = "" if self._right_came else ", or set stereo to false if there is none"
            self._warnings.warn(
                "right",
                f"no image on {self.right_image.topic} is of the time of one on "
                f"{self.left_image.topic}: objects are ranged by their sizes alone. Look after "
                f"the right camera{remedy}",
            )

    @on("right_image")
    def see_right(self, image: Image) -> None:
        """Look at a left image that has waited for this one, or keep this one for it."""
        self._right_came = True
        if self.config.stereo and self._is_new("right", image, self.right_image.topic):
            self._look_at(self._pairing.take_right(to_ns(image.header.stamp), image))

    @every(hz=1)
    def watch(self) -> None:
        """See whether other objects were taught, and whether images still come."""
        try:
            if self._known.refresh():
                self._tell_known()
            self._warnings.resolved("file", f"{self.config.map_file} is read again")
        except MapFileError as error:
            self._warnings.warn("file", f"still recognizing what was taught before: {error}")
        now = self.clock.now()
        if now <= 0:
            return  # nobody has told the time yet
        self._last_left = min(self._last_left or now, now)  # time may be set back
        if now - self._last_left >= _SILENCE_NS:
            silent_s = (now - self._last_left) / SECOND
            self._warnings.warn(
                "left",
                f"no image on {self.left_image.topic} for {silent_s:.0f} s: look after the camera",
            )

    def _tell_known(self) -> None:
        count = len(self._known.now.objects)
        if count:
            self.log.info("%d taught objects of %s are recognized", count, self.config.map_file)
        else:
            self.log.warning(
                "no object was taught to %s, so none is recognized: teach some with `cairn object "
                "teach NAME IMAGE --map %s`",
                *[self.config.map_file] * 2,
            )

    def _know(self, side: str, info: CameraInfo) -> None:
        if not same_camera(info, self._infos[side]):
            self._infos[side] = info
            self._cameras = None

    def _is_new(self, side: str, image: Image, topic: str) -> bool:
        lasts_ns = self._standstills[side].lasts_ns(image, self.clock.now())
        if lasts_ns is not None and lasts_ns >= _STANDSTILL_NS:
            self._warnings.warn(
                f"{side} stands still",
                f"the images on {topic} have been the same for {lasts_ns / SECOND:.0f} s, bit for "
                "bit: the camera hangs. Start its driver anew",
            )
        if lasts_ns is None:
            self._warnings.resolved(f"{side} stands still", f"the images on {topic} change again")
        return lasts_ns is None

    def _look_at(self, pair: Pair | None) -> None:
        if pair is None:
            return
        self._warnings.resolved("left", f"images come again on {self.left_image.topic}")
        if pair.right is not None:
            self._warnings.resolved("right", f"images come again on {self.right_image.topic}")
        try:
            field, told = self._seen(pair)
            self._warnings.resolved("image", f"{self.left_image.topic} is looked at again")
        except CairnError as error:
            self._warnings.warn("image", f"nothing is recognized: {error}")
            field, told = NOWHERE, []
        self.objects.publish(
            RecognizedObjectArray(
                header=Header(stamp=from_ns(pair.stamp_ns), frame_id="base_link"),
                objects=tuple(told),
                view_right=field.right,
                view_left=field.left,
                nearest=field.nearest,
                farthest=field.farthest,
            )
        )

    def _seen(self, pair: Pair) -> tuple[Field, list[RecognizedObject]]:
        """Where objects could have been recognized, and those that were and are placed."""
        config, cameras = self.config, self._looking()
        left = cameras.left.apply(self._gray(pair.left, self.left_image.topic))
        features = extract(left, config.most_features)
        blind = blindness(left)
        if blind:
            self._warnings.warn("blind", f"{self.left_image.topic}: {blind}")
        else:
            self._warnings.resolved("blind", f"{self.left_image.topic} shows something again")
        known = self._known.now
        if shows_little(features) or not known.objects:
            return NOWHERE, []
        right = self._rectified_right(cameras, pair)
        found = known.recognizer.recognize(features, left.shape[1], left.shape[0])
        sightings = without_wrong_twins(
            [sighted(one, known.objects, cameras, left, right) for one in found]
        )
        if any(one.by_stereo for one in sightings):
            self._warnings.resolved("stereo", "objects are ranged by stereo again")
        elif right is not None and sightings:
            self._question_stereo(left, right, features, cameras)
        placed = [(one, self._place(one)) for one in sightings]
        told = [
            _message(one, place)
            for one, place in placed
            if place is not None and config.nearest <= place.range <= config.farthest
        ]
        if blind or any(place is None for _, place in placed):
            # What is seen but not told of, or is in the dark, must not be thought to be gone.
            return NOWHERE, told
        return field_of(cameras.rig, config.mount.pose, config.nearest, config.farthest), told

    def _place(self, sighting: Sighting) -> Place | None:
        """Where what was sighted is, None if it is not to be told; what is odd about it is told."""
        recognition = sighting.recognition
        if sighting.ratio is not None:
            wrong = self._agreement.add(recognition.name, sighting.ratio)
            if wrong:
                self._warnings.warn("agreement", wrong)
        if sighting.doubt:
            self._warnings.warn(f"doubt {recognition.object_id}", sighting.doubt)
        if sighting.located is None or recognition.inliers < self.config.least_inliers:
            return None
        return place_of(sighting.located, self.config.mount.pose, self.config.bearing_sd)

    def _question_stereo(
        self, left: Gray, right: Gray, features: Features, cameras: Cameras
    ) -> None:
        """Tell why stereo tells nothing; raises `CairnError` if the cameras are swapped."""
        if swapped(left, right, features, cameras.rig):
            raise CairnError(
                f"{self.left_image.topic} shows what the right camera sees: swap the cameras"
            )
        why = unlike(left, right, features, cameras.rig)
        if why:
            self._warnings.warn(
                "stereo",
                f"{self.right_image.topic}: objects are ranged by their sizes alone: {why}",
            )

    def _looking(self) -> Cameras:
        """The cameras as they are calibrated; raises `CairnError` if the left one is not."""
        if self._cameras is None:
            left, right = self._infos["left"], self._infos["right"]
            if left is None:
                raise CairnError(
                    f"no CameraInfo has come on {self.left_info.topic}: have the camera's driver "
                    "send it"
                )
            self._cameras = cameras_of(left, right if self.config.stereo else None)
        if self._cameras.complaint:
            self._warnings.warn(
                "pair", f"objects are ranged by their sizes alone: {self._cameras.complaint}"
            )
        else:
            self._warnings.resolved("pair", "left and right cameras are a pair")
        return self._cameras

    def _rectified_right(self, cameras: Cameras, pair: Pair) -> Gray | None:
        if pair.right is None or cameras.right is None:
            return None
        try:
            if np.array_equal(pair.left.data, pair.right.data):
                raise CairnError(
                    f"{self.right_image.topic} shows the same as {self.left_image.topic}, bit for "
                    "bit: have the right camera's driver send its own images"
                )
            right = cameras.right.apply(self._gray(pair.right, self.right_image.topic))
            self._warnings.resolved("right image", f"{self.right_image.topic} is looked at again")
            return right
        except CairnError as error:
            self._warnings.warn("right image", f"ranged by their sizes alone: {error}")
            return None

    @staticmethod
    def _gray(image: Image, topic: str) -> Gray:
        try:
            return gray_of(image)
        except CairnError as error:
            raise CairnError(f"{topic}: {error}") from error


def _message(sighting: Sighting, place: Place) -> RecognizedObject:
    recognition = sighting.recognition
    return RecognizedObject(
        object_id=recognition.object_id,
        range=place.range,
        bearing=place.bearing,
        covariance=place.covariance.ravel(),
        inliers=recognition.inliers,
        alternatives=np.array(recognition.alternatives, np.uint32),
        corners=recognition.corners.ravel(),
    )
