"""The component ObjectRecognizer: from camera images to observations of objects."""

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
from cairn.components.object_recognizer.cameras import (
    CameraCalibration,
    Cameras,
    FrozenImageDetector,
    StereoImages,
    StereoSynchronizer,
    cameras_are_swapped,
    gray_image,
    shows_little,
    why_blind,
    why_no_pair,
)
from cairn.components.object_recognizer.config import ObjectRecognizerConfig
from cairn.components.object_recognizer.model_library import ModelLibrary
from cairn.components.object_recognizer.observation import (
    NO_VIEW,
    FieldOfView,
    RangeAgreement,
    field_of_view,
    make_observation,
    measure_range,
    reject_mixed_up_twins,
)
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from cairn.vision.features import Features, extract
from cairn.vision.images import Gray
from cairn.vision.recognition import Detection
from cairn.visual_map.sqlite_file import MapFileError

# A camera that is silent, or sends the same image, for this long is reported.
_SILENCE_NS = 2 * SECOND
_FROZEN_NS = SECOND


class ObjectRecognizer(Component):
    """Recognizes objects in the images of a camera or of a stereo pair.

    Publishes for every new image which objects are in it, where they are relative to the robot, and
    where objects could have been recognized. Corners are in the rectified left image.
    """

    config: ObjectRecognizerConfig
    # Depth 1: images that arrive during processing are outdated by the newest one.
    left_image: In[Image] = In(qos=SENSOR.with_depth(1))
    right_image: In[Image] = In(qos=SENSOR.with_depth(1), optional=True)
    left_info: In[CameraInfo] = In(qos=SENSOR)
    right_info: In[CameraInfo] = In(qos=SENSOR, optional=True)
    objects: Out[RecognizedObjectArray] = Out(qos=RELIABLE.with_depth(200))

    def on_configure(self) -> None:
        """Read the object models, so that a damaged file is reported before anything moves."""
        cv2.setNumThreads(self.config.threads)
        self._library = ModelLibrary(self.config.map_file)
        self._log_models()
        self._warnings = RateLimitedLog(self.log)
        self._calibration = CameraCalibration()

    def on_activate(self) -> None:
        """Wait for images."""
        self._synchronizer = StereoSynchronizer(stereo=self.config.stereo)
        self._frozen = {"left": FrozenImageDetector(), "right": FrozenImageDetector()}
        self._agreement = RangeAgreement()
        self._right_received = False
        self._last_left: int | None = None

    def on_parameters(self, new: Config) -> None:
        """Reject changes of the file, the number of cameras or of threads."""
        for name in ("map_file", "stereo", "threads"):
            if getattr(new, name) != getattr(self.config, name):
                raise ParameterRejected(f"{name} can only be set when the recognizer is configured")

    @on("left_info")
    def on_left_info(self, info: CameraInfo) -> None:
        """Store the left camera's calibration."""
        self._calibration.store("left", info)

    @on("right_info")
    def on_right_info(self, info: CameraInfo) -> None:
        """Store the right camera's calibration."""
        self._calibration.store("right", info)

    @on("left_image")
    def on_left_image(self, image: Image) -> None:
        """Process a left image, or keep it until its right one arrives."""
        now = self.clock.now()
        self._last_left = now
        if not self._is_new("left", image, self.left_image.topic):
            return
        self._process(self._synchronizer.add_left(to_ns(image.header.stamp), image, now))
        if self._synchronizer.right_is_missing(now) and not self._frozen["right"].frozen:
            remedy = "" if self._right_received else ", or set stereo to false for a single camera"
            self._warnings.warn(
                "right",
                f"no image on {self.right_image.topic} has the stamp of one on "
                f"{self.left_image.topic}: objects are ranged by size only; check the right "
                f"camera{remedy}",
            )

    @on("right_image")
    def on_right_image(self, image: Image) -> None:
        """Process the left image that waits for this one, or keep this one for it."""
        self._right_received = True
        if self.config.stereo and self._is_new("right", image, self.right_image.topic):
            self._process(self._synchronizer.add_right(to_ns(image.header.stamp), image))

    @every(hz=1)
    def check_inputs(self) -> None:
        """Reload changed object models, and warn if images no longer arrive."""
        try:
            if self._library.refresh():
                self._log_models()
            self._warnings.resolved("file", f"{self.config.map_file} is readable again")
        except MapFileError as error:
            self._warnings.warn("file", f"keeping the object models loaded before: {error}")
        now = self.clock.now()
        if now <= 0:
            return  # the clock has not started
        self._last_left = min(self._last_left or now, now)  # the clock may jump back
        if now - self._last_left >= _SILENCE_NS:
            silent_s = (now - self._last_left) / SECOND
            self._warnings.warn(
                "left",
                f"no image on {self.left_image.topic} for {silent_s:.0f} s; check the camera",
            )

    def _log_models(self) -> None:
        count = len(self._library.current.models)
        if count:
            self.log.info("loaded %d object models from %s", count, self.config.map_file)
        else:
            self.log.warning(
                "no object model in %s, so nothing is recognized; teach objects with `cairn object "
                "teach NAME IMAGE --map %s`",
                *[self.config.map_file] * 2,
            )

    def _is_new(self, side: str, image: Image, topic: str) -> bool:
        frozen_ns = self._frozen[side].frozen_for_ns(image, self.clock.now())
        if frozen_ns is not None and frozen_ns >= _FROZEN_NS:
            self._warnings.warn(
                f"{side} frozen",
                f"the images on {topic} have been identical for {frozen_ns / SECOND:.0f} s: the "
                "camera hangs; restart its driver",
            )
        if frozen_ns is None:
            self._warnings.resolved(f"{side} frozen", f"the images on {topic} change again")
        return frozen_ns is None

    def _process(self, images: StereoImages | None) -> None:
        if images is None:
            return
        self._warnings.resolved("left", f"images arrive again on {self.left_image.topic}")
        if images.right is not None:
            self._warnings.resolved("right", f"images arrive again on {self.right_image.topic}")
        try:
            view, observations = self._recognize(images)
            self._warnings.resolved("image", f"{self.left_image.topic} is processed again")
        except CairnError as error:
            self._warnings.warn("image", f"nothing is recognized: {error}")
            view, observations = NO_VIEW, []
        self.objects.publish(
            RecognizedObjectArray(
                header=Header(stamp=from_ns(images.stamp_ns), frame_id="base_link"),
                objects=tuple(observations),
                view_right=view.right,
                view_left=view.left,
                nearest=view.nearest,
                farthest=view.farthest,
            )
        )

    def _recognize(self, images: StereoImages) -> tuple[FieldOfView, list[RecognizedObject]]:
        """Return where objects could have been recognized, and the observations."""
        config, cameras = self.config, self._calibrated_cameras()
        left = cameras.left.apply(gray_image(images.left, self.left_image.topic))
        features = extract(left, config.most_features)
        blind = why_blind(left)
        if blind:
            self._warnings.warn("blind", f"{self.left_image.topic}: {blind}")
        else:
            self._warnings.resolved("blind", f"{self.left_image.topic} shows something again")
        loaded = self._library.current
        if shows_little(features) or not loaded.models:
            return NO_VIEW, []
        right = self._rectified_right(cameras, images)
        detections = loaded.recognizer.recognize(features, left.shape[1], left.shape[0])
        detections = reject_mixed_up_twins(
            [measure_range(one, loaded.models, cameras, left, right) for one in detections]
        )
        if any(one.has_stereo_range for one in detections):
            self._warnings.resolved("stereo", "objects are ranged by stereo again")
        elif right is not None and detections:
            self._check_stereo(left, right, features, cameras)
        observations = [self._observe(one) for one in detections]
        published = [
            one
            for one in observations
            if one is not None and config.nearest <= one.range <= config.farthest
        ]
        if blind or any(one is None for one in observations):
            # Objects that are visible but not published, or in the dark, must not count as missing.
            return NO_VIEW, published
        view = field_of_view(cameras.rig, config.mount.pose, config.nearest, config.farthest)
        return view, published

    def _observe(self, detection: Detection) -> RecognizedObject | None:
        """Return the observation, None if it is not reliable; warn about contradictions."""
        if detection.range_ratio is not None:
            wrong = self._agreement.add(detection.name, detection.range_ratio)
            if wrong:
                self._warnings.warn("agreement", wrong)
        if detection.warning:
            self._warnings.warn(f"range {detection.object_id}", detection.warning)
        if detection.inliers < self.config.least_inliers:
            return None
        return make_observation(detection, self.config.mount.pose, self.config.bearing_sd)

    def _check_stereo(self, left: Gray, right: Gray, features: Features, cameras: Cameras) -> None:
        """Warn why stereo measures nothing; raise `CairnError` if the cameras are swapped."""
        if cameras_are_swapped(left, right, features, cameras.rig):
            raise CairnError(
                f"{self.left_image.topic} shows the right camera's images; swap the cameras"
            )
        why = why_no_pair(left, right, features, cameras.rig)
        if why:
            self._warnings.warn(
                "stereo", f"{self.right_image.topic}: objects are ranged by size only: {why}"
            )

    def _calibrated_cameras(self) -> Cameras:
        """Return the calibrated cameras; raise `CairnError` if the left one is not calibrated."""
        cameras = self._calibration.cameras(self.left_info.topic, stereo=self.config.stereo)
        if cameras.pair_error:
            self._warnings.warn("pair", f"objects are ranged by size only: {cameras.pair_error}")
        else:
            self._warnings.resolved("pair", "left and right cameras are a pair again")
        return cameras

    def _rectified_right(self, cameras: Cameras, images: StereoImages) -> Gray | None:
        if images.right is None or cameras.right is None:
            return None
        try:
            if np.array_equal(images.left.data, images.right.data):
                raise CairnError(
                    f"{self.right_image.topic} shows the same image as {self.left_image.topic}, "
                    "bit for bit; have the right camera's driver publish its own images"
                )
            right = cameras.right.apply(gray_image(images.right, self.right_image.topic))
            self._warnings.resolved("right image", f"{self.right_image.topic} is processed again")
            return right
        except CairnError as error:
            self._warnings.warn("right image", f"objects are ranged by size only: {error}")
            return None
