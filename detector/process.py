"""Modules of ours as processes beside the daemon (edge)."""

import os
import subprocess
import sys


def own_environ() -> dict[str, str]:
    """The environment in which a Python finds its modules where this one does, whatever lies in the present folder."""
    path = os.pathsep.join(folder for folder in sys.path if folder)
    return {**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"}


def begun(module: str) -> subprocess.Popen[bytes]:
    """Start a module; its pipes have no buffers. Raises OSError.

    It is in a session of its own, for Ctrl-C is the daemon's business.
    """
    command, pipe = [sys.executable, "-m", module], subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, bufsize=0, env=own_environ(), start_new_session=True)
