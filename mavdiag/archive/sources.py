"""Which code made an answer (edge): a digest of sources and of what they compute with, so that answers never mix."""

import hashlib
from collections.abc import Iterator
from functools import cache
from importlib import metadata, resources
from importlib.resources.abc import Traversable

COMPUTED_BY = ("numpy", "scipy", "numba", "pymavlink", "pyulog")  # whose versions may change a figure


@cache
def digest_of_sources(packages: tuple[str, ...], unrelated: tuple[str, ...] = ("__pycache__",)) -> str:
    """A digest of all sources and data of packages and of the versions of what computes, 16 hexadecimal digits.

    unrelated: ends of the paths that are left out.
    """
    digest = hashlib.sha256(repr([(name, _version(name)) for name in COMPUTED_BY]).encode())
    for package in packages:
        for name, content in sorted(_sources(resources.files(package), package, unrelated)):
            digest.update(name.encode() + hashlib.sha256(content).digest())
    return digest.hexdigest()[:16]


def judging_version() -> str:
    """The digest of this package."""
    return digest_of_sources(("mavdiag",))


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
