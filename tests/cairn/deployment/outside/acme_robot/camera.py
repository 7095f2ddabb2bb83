"""A camera whose library is not installed here."""

import acme_camera_library  # type: ignore[import-not-found]  # noqa: F401
