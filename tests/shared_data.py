"""Where the recorded flights and reference values are, when they are there at all."""

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
