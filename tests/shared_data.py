"""Where the recorded flights and reference values are, when they are there at all; and files that tests write."""

import os
from pathlib import Path

import pytest

ROOT = Path(os.environ.get("MAVDIAG_SHARED", Path(__file__).resolve().parents[2] / "shared"))


def shared(relative: str) -> Path:
    """Path of recorded data beside the checkout; skips the test, saying so, where it is absent."""
    path = ROOT / relative
    if not path.exists():
        pytest.skip(f"recorded data not present: {relative} (set MAVDIAG_SHARED to its folder)")
    return path


def written(path: Path, content: str | bytes) -> Path:
    """The path of a file with this content."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path
