"""Reads and writes calibration files in the format of ROS (camera_info_manager's YAML)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from cairn.errors import CairnError
from cairn.limits.files import read_text_bounded
from cairn.limits.yaml import YAML_BYTES, no_boolean, parse_opencv_yaml, yaml_fault
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.schemas.std_msgs import Header
from cairn.system.files import explain_os_error, explained, replace_file
from cairn.vision.rectification import CameraModel

Finite = Annotated[float, Field(allow_inf_nan=False), BeforeValidator(no_boolean)]
Count = Annotated[int, BeforeValidator(no_boolean)]


class _Matrix(BaseModel):
    model_config = ConfigDict(extra="ignore")

    rows: Count = Field(ge=1)
    cols: Count = Field(ge=0)
    data: list[Finite]

    @model_validator(mode="after")
    def _whole(self) -> _Matrix:
        if len(self.data) != self.rows * self.cols:
            raise ValueError(
                f"must have rows * cols = {self.rows * self.cols} numbers, not {len(self.data)}"
            )
        return self


class _CameraFile(BaseModel):
    """The keys of the file (camera_calibration_parsers); other keys are ignored."""

    model_config = ConfigDict(extra="ignore")

    image_width: Count = Field(gt=0, le=100_000)
    image_height: Count = Field(gt=0, le=100_000)
    distortion_model: str = "plumb_bob"
    camera_matrix: _Matrix
    distortion_coefficients: _Matrix
    rectification_matrix: _Matrix = _Matrix(rows=3, cols=3, data=[0.0] * 9)
    projection_matrix: _Matrix = _Matrix(rows=3, cols=4, data=[0.0] * 12)


_SHAPES = {
    "camera_matrix": (3, 3),
    "rectification_matrix": (3, 3),
    "projection_matrix": (3, 4),
}


def read_camera(file: Path, frame_id: str = "") -> CameraInfo:
    """Read a calibration file, for the camera whose optical frame is `frame_id`.

    Raises `CairnError`, which names file, key and value, if it is not a valid calibration.
    """
    found = _load(file)
    for key, shape in _SHAPES.items():
        matrix = getattr(found, key)
        if (matrix.rows, matrix.cols) != shape:
            raise CairnError(
                f"{file}: {key} is {matrix.rows} x {matrix.cols}, but must be {shape[0]} x "
                f"{shape[1]}; {_REMEDY}"
            )
    info = CameraInfo(
        header=Header(frame_id=frame_id),
        width=found.image_width,
        height=found.image_height,
        distortion_model=found.distortion_model,
        d=np.array(found.distortion_coefficients.data, np.float64),
        k=np.array(found.camera_matrix.data, np.float64),
        r=np.array(found.rectification_matrix.data, np.float64),
        p=np.array(found.projection_matrix.data, np.float64),
    )
    try:
        CameraModel.of(info)
    except CairnError as error:
        text = str(error)
        raise CairnError(text if text.startswith(f"{file}: ") else f"{file}: {text}") from error
    return info


def write_camera(file: Path, info: CameraInfo, name: str) -> None:
    """Write the calibration of the camera `name`; raise `CairnError` if writing fails."""
    content = {
        "image_width": info.width,
        "image_height": info.height,
        "camera_name": name,
        "camera_matrix": _matrix(info.k.reshape(3, 3)),
        "distortion_model": info.distortion_model,
        "distortion_coefficients": _matrix(info.d.reshape(1, -1)),
        "rectification_matrix": _matrix(info.r.reshape(3, 3)),
        "projection_matrix": _matrix(info.p.reshape(3, 4)),
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=math.inf)
    with explained(f"{file}: the calibration cannot be written"):
        replace_file(file, text.encode())


_REMEDY = "calibrate the camera again with `cairn camera calibrate`, or use an intact copy"


def _load(file: Path) -> _CameraFile:
    try:
        text = read_text_bounded(file, YAML_BYTES)
        content = parse_opencv_yaml(text)
    except FileNotFoundError as error:
        raise CairnError(
            f"{file}: no such calibration file; make one with `cairn camera calibrate`"
        ) from error
    except OSError as error:
        raise CairnError(
            f"{file}: the calibration cannot be read: {explain_os_error(error)}"
        ) from error
    except UnicodeDecodeError as error:
        raise CairnError(f"{file}: not a calibration in YAML: {error}; {_REMEDY}") from error
    except yaml.YAMLError as error:
        if "[image]" in text:
            raise CairnError(f"{file}: is a file ost.txt; give the ost.yaml beside it") from error
        position, fault = yaml_fault(error)
        raise CairnError(
            f"{file}{position}: not a calibration in YAML: {fault}; {_REMEDY}"
        ) from error
    if isinstance(content, dict) and "cam0" in content:
        raise CairnError(f"{file}: is a camchain of Kalibr; convert it to ROS's camera_info YAML")
    if isinstance(content, dict) and {"width", "height", "k", "d"} <= content.keys():
        content = _of_message(content)
    if not isinstance(content, dict):
        raise CairnError(f"{file}: not a calibration in YAML: it has no keys; {_REMEDY}")
    try:
        return _CameraFile.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        value = "" if first["type"] == "missing" else f" = {str(first['input'])[:60]}"
        raise CairnError(f"{file}: {key}{value}: {first['msg'].lower()}; {_REMEDY}") from error


def _of_message(content: dict[Any, Any]) -> dict[Any, Any]:
    """Return the keys of the file for those of a message CameraInfo, as `ros2 topic echo` has."""
    given = {"image_width": content["width"], "image_height": content["height"]}
    shapes = {"k": (3, 3), "r": (3, 3), "p": (3, 4)} | {"d": (1, len(content["d"] or ()))}
    names = dict(zip("krpd", (*_SHAPES, "distortion_coefficients"), strict=True))
    for key, (rows, columns) in shapes.items():
        if key in content:
            given[names[key]] = {"rows": rows, "cols": columns, "data": content[key]}
    return content | given


def _matrix(values: NDArray[np.float64]) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}
