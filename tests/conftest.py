"""Shared set-up: the tests' own modules are importable, hypothesis is reproducible."""

import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))

settings.register_profile("repo", deadline=None, print_blob=True, derandomize=True, max_examples=60)
settings.load_profile("repo")
