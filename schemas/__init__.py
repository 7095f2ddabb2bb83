"""Every message on the bus, one definition each; no logic."""
