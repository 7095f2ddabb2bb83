"""Where a component runs: a process of its own, its parent's process, or lockstep."""
