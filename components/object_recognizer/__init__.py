"""The object recognizer: recognizes objects in camera images and measures where they are."""
