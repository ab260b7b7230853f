"""How every command of this project behaves at its edge: one line on stderr for an error, and a stated exit code.

0 done, 1 a verdict that asks for action, 2 an error, 3 not judgeable, 4 suspected, 130 stopped by a signal.
"""

import functools
import inspect
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NoReturn, TextIO

import typer
from typer.core import TyperCommand, TyperGroup

from mavdiag import __version__
from mavdiag.errors import MavdiagError
from mavdiag.printable import printable

ERROR = 2
INTERRUPTED = 130


class _ShowByDefault(TyperGroup):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        named = bool(args) and args[0] in (*self.commands, "--help")
        return super().parse_args(ctx, args if named else ["show", *args])


class _Command(TyperCommand):
    """No argument may be empty: as a path it would be the present folder."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        for before, value in pairwise(["", *args]):
            if not value or (value.startswith("--") and value.partition("=")[1:] == ("=", "")):
                ctx.fail(f"an empty value behind {value or before or 'the command'}: give one, or leave it out")
        return super().parse_args(ctx, args)


class _App(typer.Typer):
    """Every command of it has --version."""

    def command(self, *args: Any, **how: Any) -> Callable[[Any], Any]:
        register = super().command(*args, **{"cls": _Command, **how})

        def add(function: Callable[..., None]) -> Callable[..., None]:
            @functools.wraps(function)
            def run_it(*, version: bool, **given: Any) -> None:
                function(**given)

            own = inspect.signature(function, eval_str=True).parameters.values()
            asked = inspect.Parameter("version", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=_Version)
            run_it.__signature__ = inspect.Signature([*own, asked])  # type: ignore[attr-defined]  # of a function
            register(run_it)
            return function

        return add


def application(summary: str, *, alone: bool = False, show_by_default: bool = False) -> typer.Typer:
    """A command-line application in one style. alone: it has one command, which is the program.

    show_by_default: the sub-command `show` is meant where none is named.
    """
    app = _App(
        help=summary,
        cls=_ShowByDefault if show_by_default else None,
        no_args_is_help=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    if not alone:

        @app.callback()
        def root(version: _Version = False) -> None:
            pass

    return app


def _show_version(context: typer.Context, wanted: bool) -> None:
    if wanted:
        typer.echo(f"{context.find_root().info_name} {__version__}")
        raise typer.Exit


_Version = Annotated[
    bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
]


def run(app: typer.Typer, name: str) -> NoReturn:
    """Run an application and end the process; errors become one line on stderr, and signals end it as Ctrl-C does."""
    told = ""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)
    for stream in ("stdout", "stderr"):
        if getattr(sys, stream) is None:  # closed, as by >&-
            setattr(sys, stream, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115  # as long as it runs
        getattr(sys, stream).reconfigure(errors="backslashreplace")  # what a terminal cannot show
    try:
        code = app(prog_name=name, standalone_mode=False)
        sys.stdout.flush()
        if code == INTERRUPTED:  # newer releases of typer make this of a KeyboardInterrupt
            told = "stopped"
    except typer.TyperException as error:
        code, message = ERROR, error.format_message()
        if message.startswith("Usage:"):  # called without arguments, the help itself is the message
            say(*message.split("\n"), err=True)
        else:
            context = getattr(error, "ctx", None)  # of the sub-command whose options or arguments are wrong
            told = f"{_line(message)}; see `{context.command_path if context else name} --help`"
    except MavdiagError as error:
        code, told = ERROR, _line(str(error))
    except (KeyboardInterrupt, typer.Abort):
        code, told = INTERRUPTED, "stopped"
    except (BrokenPipeError, SystemExit) as error:
        if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
            raise
        # The reader of our output has gone (`... | head`): what is left is not judged; typer would end with 1.
        _silence(sys.stdout)
        code = ERROR
    except OSError as error:
        _silence(sys.stdout)
        where = "its path and its disk" if error.filename else "where the output goes, and its disk"
        code, told = ERROR, f"{_line(str(error))}; check {where}"
    except Exception as error:
        below: BaseException | None = error
        while below is not None and not isinstance(below, KeyboardInterrupt):
            below = below.__cause__
        if below is None:  # a fault of ours: 1 would be a verdict
            traceback.print_exc()
            raise SystemExit(ERROR) from error
        code, told = INTERRUPTED, "stopped"  # compiled code makes a SystemError of it, or one of that
    try:
        if told:
            say(f"{name}: {told}", err=True)
    except OSError:
        _silence(sys.stderr)
    sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """Let SIGINT, SIGTERM and SIGHUP ask for an end instead of ending the process at once; yields whether one came."""
    caught: list[int] = []
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as `nohup` has it
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, lambda n, _: caught.append(n)) for number in numbers}
    try:
        yield lambda: bool(caught)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def own_environ() -> dict[str, str]:
    """The environment in which a Python finds its modules where this one does, whatever lies in the present folder."""
    path = os.pathsep.join(folder for folder in sys.path if folder)
    return {**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"}


def say(*lines: str, err: bool = False) -> None:
    """Print lines; what could steer a terminal, or break one of them, is its escape. err: to stderr."""
    typer.echo("\n".join(map(printable, lines)), err=err)


def _silence(stream: TextIO) -> None:
    """Throw away what is left to write there, which would fail once more at the end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _line(message: str) -> str:
    return printable(" ".join(message.split()).rstrip("."))
