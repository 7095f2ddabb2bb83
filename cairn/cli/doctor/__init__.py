"""`cairn doctor`: check a computer for what a robot needs, with a remedy for each fault."""
