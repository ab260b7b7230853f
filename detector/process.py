"""A module of ours as a process beside the daemon (edge)."""

import os
import subprocess
import sys


def begun(module: str) -> subprocess.Popen[bytes]:
    """Start a module with our own search path, whatever lies in the present folder; its pipes have no buffers.

    It is in a session of its own, for Ctrl-C is the daemon's business. Raises OSError.
    """
    environ = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command, pipe = [sys.executable, "-P", "-m", module], subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, bufsize=0, env=environ, start_new_session=True)
