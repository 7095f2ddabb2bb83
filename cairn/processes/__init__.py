"""Runs a deployment: supervisors, the zygote, where each component runs, the machines, lockstep."""
