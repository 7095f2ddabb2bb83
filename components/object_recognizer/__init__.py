"""The object recognizer: which taught objects the camera sees, and where they are."""
