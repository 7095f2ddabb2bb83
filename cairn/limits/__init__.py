"""Readers with limits: files of users and data of other processes, refused when too large."""
