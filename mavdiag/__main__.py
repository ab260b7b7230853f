"""`python -m mavdiag`."""

from mavdiag.cli import main

main()
