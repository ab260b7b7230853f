"""Where the programs of this project begin (edge), and `python -m mavdiag`: Ctrl-C is quiet while they load, too."""

import gc
import os
import signal
import sys
from importlib import import_module
from typing import NoReturn

INTERRUPTED = 130  # as of `mavdiag.commandline`, which takes time to load


def start(module: str) -> NoReturn:
    """Load a program and run it."""
    found = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    asked = {number: how for number, how in found.items() if how in (signal.SIG_DFL, signal.default_int_handler)}
    for number in asked:  # what is ignored stays so; an exception may become another one while classes are made
        signal.signal(number, lambda *_: os._exit(INTERRUPTED))
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy loads: its idle threads cost a sixth of the time
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # to look for them reads what every package brings
    gc.disable()  # what is loaded stays: to go through it again and again is a quarter of the time
    main = import_module(module).main
    gc.freeze()
    gc.enable()
    for number, how in asked.items():
        signal.signal(number, how)
    sys.exit(main())


def main() -> NoReturn:
    """Entry point of `mavdiag`."""
    start("mavdiag.cli")


def detector() -> NoReturn:
    """Entry point of `mavdiag-detector`."""
    start("detector.__main__")


def plant() -> NoReturn:
    """Entry point of `sitl-plant`."""
    start("sitl_plant.__main__")


if __name__ == "__main__":
    main()
