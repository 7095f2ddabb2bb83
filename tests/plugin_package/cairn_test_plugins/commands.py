"""A subcommand of `cairn` as a package adds it."""

import typer


def greet(name: str) -> None:
    """Say hello."""
    typer.echo(f"hello, {name}")
