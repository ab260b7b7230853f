"""The error tree, split by who is at fault. Every message is one line that says what to do.

The wire never raises: malformed bytes are counted and dropped.
"""

from importlib.util import find_spec


class MavdiagError(Exception):
    """Base of all errors that this project raises on purpose."""


class UsageError(MavdiagError):
    """You asked for what cannot be: a bad argument, address or configuration value."""


def missing_extra(what: str, package: str, extra: str) -> UsageError:
    """The error where a package of an extra is not installed: `what` needs it."""
    return UsageError(f"{what} needs {package}, which is not installed: pip install 'mavdiag[{extra}]'")


def check_installed(what: str, package: str, extra: str) -> None:
    """Raise UsageError, saying what to install, unless a package of an extra is there."""
    if find_spec(package.lower()) is None:
        raise missing_extra(what, package, extra)


class InputError(MavdiagError):
    """A file or a data set is damaged, empty, of another kind, or lacks a signal that is needed."""


class BaselineError(InputError):
    """A baseline cannot be loaded or does not fit this vehicle or link; the message names the field.

    short: the same for a pilot, in 40 characters, where it is told apart from the message.
    """

    def __init__(self, message: str, short: str = "") -> None:
        super().__init__(message)
        self.short = short or message


class LinkError(MavdiagError):
    """A port or a peer cannot be reached, or went away."""


class IdentificationError(MavdiagError):
    """The data cannot carry the model that was asked for: too short, not excited, unstable."""
