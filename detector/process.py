"""Modules of ours as processes beside the daemon (edge)."""

import subprocess
import sys

from mavdiag.commandline import own_environ


def begun(module: str) -> subprocess.Popen[bytes]:
    """Start a module; its pipes have no buffers. Raises OSError.

    It is in a session of its own, for Ctrl-C is the daemon's business.
    """
    command, pipe = [sys.executable, "-m", module], subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, bufsize=0, env=own_environ(), start_new_session=True)
