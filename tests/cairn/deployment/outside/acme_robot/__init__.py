"""Plugins of a company outside of the repository, installed as the distribution acme-robot."""
