"""The simulated image sensor: noise, vignetting, saturation and blur as configured."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.simulation.camera_optics import ImageSensor, SensorNoise, blurred

NONE = SensorNoise(0.0, 0.0)


def image_sensor(seed: int = 0) -> ImageSensor:
    return ImageSensor(320, 240, np.random.default_rng(seed))


def uniform_light(gray: float) -> np.ndarray:
    return np.full((240, 320), gray, np.float32)


@pytest.mark.parametrize("gray", [20.0, 100.0, 200.0])
def test_noise_has_the_configured_deviation(gray: float) -> None:
    noise = SensorNoise(2.0, 0.05)
    image = image_sensor().expose(uniform_light(gray), 1.0, 0.0, noise).astype(float)

    expected = np.sqrt(noise.read**2 + noise.shot * gray + 1 / 12)
    assert image.mean() == pytest.approx(gray, abs=0.1)
    assert image.std() == pytest.approx(expected, rel=0.02)
    beside = np.corrcoef(image[:, 1:].ravel(), image[:, :-1].ravel())[0, 1]
    assert abs(beside) < 0.02


def test_noise_differs_between_images_and_between_rows() -> None:
    one = image_sensor()
    first, second = (
        one.expose(uniform_light(100), 1.0, 0.0, SensorNoise(3.0, 0.0)) for _ in range(2)
    )

    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(first[0], first[1])[0, 1]) < 0.3
    again = image_sensor().expose(uniform_light(100), 1.0, 0.0, SensorNoise(3.0, 0.0))
    assert np.array_equal(first, again)


def test_vignetting_darkens_corners_and_white_saturates() -> None:
    image = image_sensor().expose(uniform_light(100), 1.0, 0.3, NONE)

    assert image[120, 160] == 100
    assert image[0, 0] == image[-1, -1] == 70
    assert np.all(image_sensor().expose(uniform_light(100), 3.0, 0.0, NONE) == 255)
    assert np.all(image_sensor().expose(uniform_light(100), 0.0, 0.0, NONE) == 0)


@given(st.just(0.0) | st.floats(0.5, 3), st.floats(0, 12))
@settings(max_examples=40, deadline=None)
def test_blur_spreads_a_point_by_the_configured_width_and_keeps_its_light(
    defocus: float, motion: float
) -> None:
    light = np.zeros((61, 61), np.float32)
    light[30, 30] = 1000.0
    spread = blurred(light, defocus, motion).astype(float)
    places = np.arange(61) - 30

    def deviation(axis: int) -> float:
        profile = spread.sum(axis=axis) / spread.sum()
        return float(np.sqrt(np.sum(profile * places**2)))

    assert spread.sum() == pytest.approx(1000.0, rel=1e-3)
    assert deviation(1) == pytest.approx(defocus, abs=0.05 + 0.05 * defocus)
    across = np.hypot(defocus, motion / np.sqrt(12))
    assert deviation(0) == pytest.approx(across, abs=0.3)
