"""`mavdiag-detector --working` (edge): asks a running daemon, by its metrics, whether it does its work.

It says nothing about the vehicles: their verdict is a metric of its own.
"""

import http.client

from detector.config import split_address
from mavdiag.errors import UsageError

FRESH_S = 5.0  # figures are set once a second; older ones mean that the loop hangs (our choice)
TIMEOUT_S = 3.0
ANY = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # who listens everywhere is asked on loopback


def ask_working(metrics: str | None) -> tuple[bool, str]:
    """Whether the daemon that serves its figures there works, and why, in one line.

    Raises UsageError if there is no address.
    """
    if metrics is None:
        raise UsageError("--working asks the daemon's metrics; name the --metrics HOST:PORT that it serves")
    host, port = split_address(metrics, "metrics")
    connection = http.client.HTTPConnection(ANY.get(host, host), port, timeout=TIMEOUT_S)
    try:
        connection.request("GET", "/metrics")
        page = connection.getresponse().read().decode(errors="replace")
    except (OSError, http.client.HTTPException) as error:
        return False, f"not working: {metrics} does not answer ({error})"
    finally:
        connection.close()
    return working(page)


def working(page: str) -> tuple[bool, str]:
    """The same, from a page of figures.

    >>> working("mavdiag_session_working 1.0\\nmavdiag_figures_age_seconds 0.4\\n")
    (True, 'working')
    """
    found = dict(line.split(" ", 1) for line in page.splitlines() if line.startswith("mavdiag_") and " " in line)
    try:
        works, age_s = float(found["mavdiag_session_working"]), float(found["mavdiag_figures_age_seconds"])
    except (KeyError, ValueError):
        return False, "not working: no figures of a detector that looks at its links"
    if age_s > FRESH_S:
        return False, f"not working: the loop hangs since {age_s:.0f} s"
    return (True, "working") if works else (False, "not working: all sessions are off; the journal says why")
