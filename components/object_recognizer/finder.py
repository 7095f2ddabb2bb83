"""The component ObjectFinder: proposes things that were never taught as new landmarks."""

from __future__ import annotations

import base64
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    SENSOR,
    CairnError,
    Component,
    In,
    Out,
    RateLimitedLog,
    RetriedSave,
    every,
    from_ns,
    on,
    to_ns,
)
from cairn.components.object_recognizer.cameras import (
    CameraCalibration,
    Cameras,
    StereoImages,
    StereoSynchronizer,
    gray_image,
    shows_little,
    why_blind,
)
from cairn.components.object_recognizer.finder_config import ObjectFinderConfig
from cairn.components.object_recognizer.hypotheses import (
    Hypotheses,
    Hypothesis,
    Requirements,
    sighting_of,
)
from cairn.components.object_recognizer.model_library import ModelLibrary
from cairn.components.object_recognizer.observation import make_observation, measure_range
from cairn.components.object_recognizer.patches import find_patches
from cairn.components.object_recognizer.proposals import Proposal, Proposals, accept
from cairn.planar.messages import planar_covariance, planar_pose
from cairn.planar.poses import Pose, apart, between
from cairn.schemas.cairn_msgs import ObjectProposals, VisualMap, VisualObject
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from cairn.vision.features import Features, extract
from cairn.vision.images import Gray
from cairn.vision.object_model import ObjectModel
from cairn.vision.recognition import Detection, Recognizer
from cairn.visual_map.sqlite_file import MapFileError

Array = NDArray[np.float64]

# Images are searched where the robot was not at the last one [m], [rad].
_MOVED_M, _MOVED_RAD = 0.1, 0.1
# The pose at an image is between two estimates that are at most so far apart [ns]; images wait at
# most so long for the later one.
_GAP_NS = SECOND // 2
_MOST_ESTIMATES = 200
# Identifiers of hypotheses, and from there on of proposals, while they are recognized: no map has
# objects with such numbers.
_HYPOTHESES, _PROPOSALS = 1 << 30, 1 << 31


class ObjectFinder(Component):
    """Proposes things that were never taught, but are often recognized at one place, as landmarks.

    A proposal becomes an object when an operator accepts it, or at once by the parameter `accept`.
    It needs two cameras, and the robot's pose.

    A thing is proposed if it was recognized from at least `least_poses` poses, on `least_visits`
    visits with `away_s` between them, always at one place, and never twice in an image.
    """

    live_parameters = frozenset({"accept"})
    config: ObjectFinderConfig
    request_roles = MappingProxyType(
        {"proposals": "view", "picture": "view", "accept": "operate", "reject": "operate"}
    )

    left_image: In[Image] = In(qos=SENSOR.with_depth(1))
    right_image: In[Image] = In(qos=SENSOR.with_depth(1))
    left_info: In[CameraInfo] = In(qos=SENSOR)
    right_info: In[CameraInfo] = In(qos=SENSOR)
    localization: In[LocalizationEstimate] = In(qos=RELIABLE.with_depth(200))
    object_proposals: Out[ObjectProposals] = Out(qos=LATCHED)
    accepted_objects: Out[VisualMap] = Out(qos=LATCHED)

    def on_configure(self) -> None:
        """Read the files, so that a damaged one is reported before anything moves."""
        config = self.config
        cv2.setNumThreads(config.threads)
        folder = config.proposals_file.parent
        if not folder.is_dir():
            raise CairnError(f"{folder}: no such folder for proposals_file; make it")
        self._library = ModelLibrary(config.map_file)
        self._proposals = Proposals(config.proposals_file)
        self._hypotheses = Hypotheses(
            Requirements(config.least_poses, config.least_visits, config.away_s)
        )
        self._accepted: list[ObjectModel] = []  # until the library has them
        self._landmarks: list[VisualObject] = []  # that the map builder adds
        self._next_id = _HYPOTHESES
        self._recognizer: Recognizer | None = None
        self._warnings = RateLimitedLog(self.log)
        self._saved = RetriedSave(self, "proposals")
        self._calibration = CameraCalibration()
        self._synchronizer = StereoSynchronizer(stereo=True)
        self._estimates: deque[LocalizationEstimate] = deque(maxlen=_MOST_ESTIMATES)
        self._images: StereoImages | None = None
        self._searched_at: Pose | None = None
        self._searched_ns = -(1 << 62)

    def on_activate(self) -> None:
        """Publish the proposals that were made before."""
        self._publish()

    def on_deactivate(self) -> None:
        """Save the proposals."""
        self._save(now=True)

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer `proposals` with their list, `picture` (`number`) with a PNG image in base64.

        `accept` (`number`, and `name` if it should have another one) adds the thing to the visual
        map; `reject` (`number`) keeps it from being proposed again.
        """
        if verb == "proposals" and not arguments:
            return {"proposals": [one.describe() for one in self._proposals.waiting]}
        most = {"number", "name"} if verb == "accept" else {"number"}
        if verb not in self.request_roles or not {"number"} <= set(arguments) <= most:
            return super().on_request(verb, arguments)
        number, name = arguments["number"], arguments.get("name")
        if type(number) is not int or not isinstance(name, str | None):
            raise CairnError(f"{self.name}: {verb}: number must be an integer, name a text")
        one = self._proposals.waiting_one(number)
        if verb == "picture":
            png = cv2.imencode(".png", one.model.views[0].picture)[1].tobytes()
            return {"png": base64.b64encode(png).decode()}
        if verb == "reject":
            self._proposals.reject(number)
            self.log.info("rejected %s", one.model.name)
            self._changed()
            return {"saved": self._proposals.is_saved}
        return self._accept(one, name)

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
        """Keep a left image until its right one, and the pose, arrive."""
        self._keep(self._synchronizer.add_left(to_ns(image.header.stamp), image, self.clock.now()))

    @on("right_image")
    def on_right_image(self, image: Image) -> None:
        """Keep a pair of images until the pose arrives."""
        self._keep(self._synchronizer.add_right(to_ns(image.header.stamp), image))

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Search the images that were taken before this pose."""
        stamp = to_ns(estimate.header.stamp)
        if self._estimates and stamp <= to_ns(self._estimates[-1].header.stamp):
            self._estimates.clear()  # the clock was set back
        self._estimates.append(estimate)
        images = self._images
        if images is None or stamp < images.stamp_ns:
            return
        self._images = None
        reliable = self._pose_at(images.stamp_ns)
        if reliable is not None and self._is_due(images.stamp_ns, reliable[0]):
            self._searched_ns, self._searched_at = images.stamp_ns, reliable[0]
            try:
                self._search(images, *reliable)
                self._warnings.resolved("image", f"{self.left_image.topic} is searched again")
            except CairnError as error:
                self._warnings.warn("image", f"nothing is found: {error}")

    @every(hz=1)
    def refresh(self) -> None:
        """Take up objects that were taught; save."""
        try:
            self._library.refresh()
            self._warnings.resolved("file", f"{self.config.map_file} is readable again")
        except MapFileError as error:
            self._warnings.warn("file", f"keeping the object models loaded before: {error}")
        known = {model.name for model in self._library.current.models.values()}
        if any(model.name in known for model in self._accepted):
            self._accepted = [model for model in self._accepted if model.name not in known]
            self._recognizer = None
        self._save()

    # --- Images ---------------------------------------------------------------------------------

    def _keep(self, images: StereoImages | None) -> None:
        if images is None:
            return
        if images.right is None:
            self._warnings.warn(
                "right",
                f"no image on {self.right_image.topic} has the stamp of one on "
                f"{self.left_image.topic}: nothing is found without a right image",
            )
            return
        self._warnings.resolved("right", f"images arrive again on {self.right_image.topic}")
        # Newer ones do not replace those that wait: else the pose would always be older than them.
        waiting = self._images
        if waiting is None or not 0 <= images.stamp_ns - waiting.stamp_ns < _GAP_NS:
            self._images = images

    def _pose_at(self, stamp: int) -> tuple[Pose, Array] | None:
        """Return the robot's pose, with its covariance (3, 3), at an image; None if unreliable."""
        for before, after in zip(self._estimates, list(self._estimates)[1:], strict=False):
            first, last = to_ns(before.header.stamp), to_ns(after.header.stamp)
            if first <= stamp <= last:
                if last - first > _GAP_NS or not all(map(self._is_reliable, (before, after))):
                    return None
                poses = planar_pose(before.pose.pose), planar_pose(after.pose.pose)
                pose = between(*poses, (stamp - first) / (last - first))
                return pose, np.array(planar_covariance(after.pose))
        return None

    def _is_reliable(self, estimate: LocalizationEstimate) -> bool:
        config = self.config
        return (
            estimate.located
            and estimate.health >= config.least_health
            and estimate.position_sd <= config.most_spread
        )

    def _is_due(self, stamp: int, pose: Pose) -> bool:
        if 0 <= stamp - self._searched_ns < SECOND / self.config.images_per_s:
            return False
        last = self._searched_at
        return last is None or apart(last, pose, _MOVED_M, _MOVED_RAD)

    def _search(self, images: StereoImages, pose: Pose, covariance: Array) -> None:
        """Recognize what is known in a pair of images, and find new hypotheses."""
        cameras = self._calibrated_cameras()
        assert images.right is not None
        assert cameras.right is not None
        left = cameras.left.apply(gray_image(images.left, self.left_image.topic))
        right = cameras.right.apply(gray_image(images.right, self.right_image.topic))
        features = extract(left, self.config.most_features)
        if why_blind(left) or shows_little(features):
            return
        rows, columns = left.shape
        known = self._library.current.recognizer.recognize(features, columns, rows)
        own = self._own_recognizer()
        found = own.recognize(features, columns, rows)
        models = {model.object_id: model for model in own.objects}
        seen = []
        for one in found:
            if one.object_id in self._hypotheses:
                ranged = measure_range(one, models, cameras, left, right)
                observed = make_observation(ranged, self.config.mount.pose, self.config.bearing_sd)
                if observed is not None and ranged.ranges_agree:
                    seen.append((one.object_id, sighting_of(observed, pose, covariance)))
        if self._hypotheses.recognized(images.stamp_ns, seen):
            self._recognizer = None
        self._propose()
        self._add_hypotheses(left, right, features, [*known, *found], cameras)

    def _add_hypotheses(
        self,
        left: Gray,
        right: Gray,
        features: Features,
        taken: list[Detection],
        cameras: Cameras,
    ) -> None:
        """Make a hypothesis of the most detailed new thing in an image."""
        config = self.config
        outlines = [one.corners for one in taken]
        patches = find_patches(
            left, right, features, cameras.rig, outlines, config.nearest, config.farthest
        )
        if patches:
            self._next_id = _HYPOTHESES + (self._next_id + 1) % (_PROPOSALS - _HYPOTHESES)
            best = patches[0]
            self._hypotheses.add(
                ObjectModel(self._next_id, f"hypothesis {self._next_id}", best.size, (best.view,))
            )
            self._recognizer = None

    def _own_recognizer(self) -> Recognizer:
        """Return what recognizes hypotheses, proposals, rejected and just accepted things."""
        if self._recognizer is None:
            others = [*self._proposals.models, *self._accepted]
            self._recognizer = Recognizer(
                [
                    *self._hypotheses.models,
                    *(
                        ObjectModel(_PROPOSALS + number, model.name, model.size, model.views)
                        for number, model in enumerate(others)
                    ),
                ]
            )
        return self._recognizer

    def _calibrated_cameras(self) -> Cameras:
        cameras = self._calibration.cameras(self.left_info.topic, stereo=True)
        if cameras.right is None:
            why = cameras.pair_error or f"no CameraInfo has arrived on {self.right_info.topic}"
            raise CairnError(f"two cameras are needed: {why}")
        return cameras

    # --- Proposals ------------------------------------------------------------------------------

    def _propose(self) -> None:
        ready = self._hypotheses.take_proposed()
        if not ready:
            return
        if self._proposals.is_full:
            self._warnings.warn(
                "full",
                f"nothing more is proposed: {self._proposals.path} is full; accept or reject "
                "proposals, and delete the file to forget rejected things",
            )
        for hypothesis in ready:
            if not self._proposals.is_full:
                self._propose_one(hypothesis)
        self._changed()

    def _propose_one(self, hypothesis: Hypothesis) -> None:
        one = self._proposals.add(hypothesis)
        self.log.info(
            "proposes %s as a landmark: %.2f m x %.2f m at (%.2f m, %.2f m), recognized %d times",
            one.model.name,
            *(one.model.size or (0.0, 0.0)),
            one.position.x,
            one.position.y,
            one.seen,
        )
        if self.config.accept == "automatically":
            try:
                self._accept(one, None)
            except CairnError as error:
                self._warnings.warn("accept", f"{one.model.name} not accepted: {error}")

    def _accept(self, one: Proposal, name: str | None) -> dict[str, Any]:
        """Add a thing to the objects that the recognizer knows; errors are those of `accept`."""
        map_file = self.config.map_file
        model = accept(one, name, map_file)
        self._accepted.append(model)
        self._landmarks.append(one.landmark(model))
        self._proposals.remove(one.model.object_id)
        self.log.info("accepted %s as object %d, %s", one.model.name, model.object_id, model.name)
        self._changed()
        return {"object_id": model.object_id, "name": model.name, "map": str(map_file)}

    def _changed(self) -> None:
        self._recognizer = None
        self._save(now=True)
        self._publish()

    def _save(self, *, now: bool = False) -> None:
        if not self._proposals.is_saved:
            self._saved.attempt(
                self._proposals.save, lambda: "the last changes of proposals are lost", now=now
            )

    def _publish(self) -> None:
        header = Header(stamp=from_ns(max(0, self.clock.now())), frame_id="map")
        proposals = tuple(one.message() for one in self._proposals.waiting)
        self.object_proposals.publish(ObjectProposals(header=header, proposals=proposals))
        version = len(self._landmarks)
        self.accepted_objects.publish(
            VisualMap(header=header, version=version, objects=tuple(self._landmarks))
        )
