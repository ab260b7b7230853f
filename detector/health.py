"""`mavdiag-detector --health` (edge): asks a running daemon, by its metrics, whether it does its work."""

import http.client

from detector.config import split_metrics_address
from mavdiag.errors import UsageError

__all__ = ["FRESH_S", "ask_health", "verdict"]

FRESH_S = 5.0  # figures are set once a second; older ones mean that the loop hangs (our choice)
TIMEOUT_S = 3.0
ANY = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # who listens everywhere is asked on loopback


def ask_health(metrics: str | None) -> tuple[bool, str]:
    """Whether the daemon that serves its figures there is healthy, and why, in one line.

    Raises UsageError if there is no address.
    """
    if metrics is None:
        raise UsageError("--health asks the daemon's metrics; name the --metrics HOST:PORT that it serves")
    host, port = split_metrics_address(metrics)
    connection = http.client.HTTPConnection(ANY.get(host, host), port, timeout=TIMEOUT_S)
    try:
        connection.request("GET", "/metrics")
        page = connection.getresponse().read().decode(errors="replace")
    except (OSError, http.client.HTTPException) as error:
        return False, f"not healthy: {metrics} does not answer ({error})"
    finally:
        connection.close()
    return verdict(page)


def verdict(page: str) -> tuple[bool, str]:
    """The same, from a page of figures.

    >>> verdict("mavdiag_healthy 1.0\\nmavdiag_figures_age_seconds 0.4\\n")
    (True, 'healthy')
    """
    found = dict(line.split(" ", 1) for line in page.splitlines() if line.startswith("mavdiag_") and " " in line)
    try:
        healthy, age_s = float(found["mavdiag_healthy"]), float(found["mavdiag_figures_age_seconds"])
    except (KeyError, ValueError):
        return False, "not healthy: no figures of a detector that looks at its links"
    if age_s > FRESH_S:
        return False, f"not healthy: the loop hangs since {age_s:.0f} s"
    return (True, "healthy") if healthy else (False, "not healthy: all sessions are off; the journal says why")
