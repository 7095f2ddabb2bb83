"""Deployments: which components run, where, with what parameters, read from YAML and checked."""
