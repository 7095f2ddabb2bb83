"""`cairn experiment`: the experiments of the paper."""

import typer

app = typer.Typer(help="Run the experiments of the paper.", no_args_is_help=True)


@app.callback()
def _experiment() -> None:
    """Run the experiments of the paper."""
