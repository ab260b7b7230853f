"""`mavdiag warm`: compile what judges, so that no flight waits for it."""

import time

import typer

from mavdiag.commands.progress import working


def warm() -> None:
    """Compile what judges and keep the machine code; after an installation, for every user that runs the detector.

    The detector does so itself at its start. It takes about a minute of processor time, and half a second later on.
    """
    with working("compiling"):
        from mavdiag import chain

        started = time.monotonic()
        chain.warm()
    typer.echo(f"compiled, or loaded from where it is kept, in {time.monotonic() - started:.1f} s")
