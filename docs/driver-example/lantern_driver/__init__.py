"""The driver of the Lantern, a made-up range scanner on a serial line."""
