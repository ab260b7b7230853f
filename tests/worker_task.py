"""A task for worker processes, some of which it ends. Each of them imports this module, and it needs little."""

import os
import signal


def work(task: int) -> int:
    """In a worker process."""
    if task < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 0:
        raise ValueError("of\nours")
    return task * task
