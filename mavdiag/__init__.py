"""Hear a damaged propeller over MAVLink: identification, residuals, and alerts with a stated price."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("mavdiag")
except PackageNotFoundError:  # a bare checkout on the path, not installed
    __version__ = "0+unknown"

__all__ = ["__version__"]
