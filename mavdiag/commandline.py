"""How every command of this project behaves at its edge: one line on stderr for an error, and a stated exit code.

0 done, 1 a verdict that asks for action, 2 an error, 3 not judgeable, 130 stopped by Ctrl-C.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer

from mavdiag.errors import MavdiagError

__all__ = ["ERROR", "application", "run", "stop_signals"]

ERROR = 2
INTERRUPTED = 130


def application(summary: str) -> typer.Typer:
    """A command-line application in the house style: plain help, no tracebacks, no shell-completion options."""
    return typer.Typer(
        help=summary, add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False
    )


def run(app: typer.Typer, name: str) -> NoReturn:
    """Run an application and end the process; errors become one line on stderr."""
    try:
        code = app(prog_name=name, standalone_mode=False)
    except typer.TyperException as error:
        message = error.format_message()
        # Called without arguments, the help itself is the message.
        _say(message if message.startswith("Usage:") else f"{name}: {_line(message)}; see `{name} --help`")
        code = ERROR
    except MavdiagError as error:
        _say(f"{name}: {_line(str(error))}")
        code = ERROR
    except (KeyboardInterrupt, typer.Abort):
        _say(f"{name}: stopped")
        code = INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has gone (`... | head`): nothing more to say, and nobody to say it to.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """Let SIGINT and SIGTERM ask for an end instead of ending the process at once; yields whether one came."""
    caught: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda n, _: caught.append(n)) for number in numbers}
    try:
        yield lambda: bool(caught)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _line(message: str) -> str:
    return " ".join(message.split()).rstrip(".")


def _say(line: str) -> None:
    typer.echo(line, err=True)
