"""The token of the live page (edge: it reads a file)."""

from pathlib import Path

from mavdiag.errors import UsageError
from mavdiag.link.keys import read_secret

__all__ = ["LEAST", "read_token"]

LEAST = 16  # characters
FORM = f"{LEAST} or more ASCII characters without blanks"


def read_token(path: Path) -> str:
    """The token in a file. Raises UsageError unless the file keeps the rules of a key file, and the line will do."""
    text = read_secret(path, "web token", FORM).decode("ascii", errors="replace")
    if len(text) < LEAST or not all("!" <= one <= "~" for one in text):
        raise UsageError(f"{path}: a web token is one line: {FORM}")
    return text
