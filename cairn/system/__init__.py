"""The computer under Cairn: clock, processes, signals, heap, files, the runtime folder."""
