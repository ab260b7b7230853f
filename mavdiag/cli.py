"""The `mavdiag` command (edge): reads arguments, calls the library, prints."""

from typing import Annotated, NoReturn

import typer

from mavdiag import __version__, commandline
from mavdiag.commands import balance, baseline, identify, inspect, scan
from mavdiag.demo import command as demo

__all__ = ["app", "main"]

app = commandline.application("Hear a damaged propeller: identify a healthy airframe, judge its flights by it.")
app.command("identify")(identify.identify)
app.command("scan")(scan.scan)
app.command("demo")(demo.demo)
app.command("balance")(balance.balance)
app.command("inspect")(inspect.inspect)
app.add_typer(baseline.app, name="baseline")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"mavdiag {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def main() -> NoReturn:
    """Entry point of the console script."""
    commandline.run(app, "mavdiag")
