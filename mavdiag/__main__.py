"""Where the programs of this project begin (edge), and `python -m mavdiag`: Ctrl-C is quiet while they load, too."""

import sys
from contextlib import suppress
from importlib import import_module
from typing import NoReturn

INTERRUPTED = 130  # as of `mavdiag.commandline`, which takes time to load


def start(module: str) -> NoReturn:
    """Load a program and run it."""
    with suppress(KeyboardInterrupt):
        import_module(module).main()
    sys.exit(INTERRUPTED)


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
