"""The object recogniser: which taught objects the camera sees, and where they are."""
