"""Releases: a deployment with its files and packages, as `cairn deploy push` copies it.

On the machine, a folder for each robot has:

    releases/ID/             ROBOT.yaml, files/, release.json, environment -> ../../environments/ID
    environments/ID/         a virtual environment; releases with the same packages share it
    current -> releases/ID   what runs; `previous` is what ran before
"""
