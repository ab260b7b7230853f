"""Which code made an answer (edge): a digest of the sources and of what they compute with, so that answers of another
version are never mixed in."""

import hashlib
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import metadata, resources
from importlib.resources.abc import Traversable

COMPUTED_BY = ("numpy", "scipy", "numba", "pymavlink", "pyulog")  # whose versions may change a figure
# What cannot change a verdict: bytecode, what is above judging, and what only draws or learns.
UNRELATED = (
    *("__pycache__", "py.typed", "__main__.py", "mavdiag/__init__.py", "mavdiag/cli.py", "mavdiag/commandline.py"),
    *("mavdiag/commands", "mavdiag/demo", "mavdiag/face.py", "mavdiag/as_json.py"),
    *("mavdiag/terminal", "mavdiag/drawing.py", "mavdiag/learning", "mavdiag/testing.py", "mavdiag/link/ports"),
    *(f"mavdiag/{name}" for name in ("history", "look", "report")),
    *(f"mavdiag/archive/{name}.py" for name in ("paths", "pool", "scan", "sources", "tables")),
)


def digest_of_sources(packages: Sequence[str], unrelated: Sequence[str]) -> str:
    """A digest of all sources and data of packages, and of the versions of what computes, 16 hexadecimal digits.

    unrelated: ends of the paths that are left out.
    """
    digest = hashlib.sha256(repr([(name, _version(name)) for name in COMPUTED_BY]).encode())
    for package in packages:
        for name, content in sorted(_sources(resources.files(package), package, tuple(unrelated))):
            digest.update(name.encode() + hashlib.sha256(content).digest())
    return digest.hexdigest()[:16]


@cache
def judging_version() -> str:
    """The digest of all code that a verdict follows from."""
    return digest_of_sources(("mavdiag",), UNRELATED)


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _sources(folder: Traversable, path: str, unrelated: tuple[str, ...]) -> Iterator[tuple[str, bytes]]:
    for entry in folder.iterdir():
        name = f"{path}/{entry.name}"
        if not name.endswith(unrelated):
            yield from _sources(entry, name, unrelated) if entry.is_dir() else [(name, entry.read_bytes())]
