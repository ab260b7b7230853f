"""`mavdiag-detector --check` and `--working` (edge)."""

import http.client
from collections.abc import Iterator, Mapping
from pathlib import Path

from detector.config import ANY, NOT_KEPT, Settings, split_address
from detector.journal import check_files
from detector.judging import chain_for
from detector.rules import parse_rules
from detector.web.access import Access
from detector.web.child import read_token
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import Baseline, check_link
from mavdiag.errors import LinkError, UsageError, check_installed
from mavdiag.link.keys import read_key
from mavdiag.link.ports import check_address
from mavdiag.storage import check_writable

FRESH_S = 5.0  # figures are set once a second; older ones mean that the loop hangs (our choice)
TIMEOUT_S = 3.0


def plan(
    settings: Settings, baseline: Baseline | None, own: Mapping[int | str, Baseline], airframe: Airframe | None
) -> Iterator[str]:
    """What a start would do, line by line; baselines and airframe as they were loaded. No link is opened.

    Raises UsageError, LinkError or BaselineError where it could not.
    """
    check_files(settings)
    check_address(settings.connect)
    yield f"link       {settings.connect}"
    rest = "" if settings.baseline or settings.learn else " with a baseline here"
    every = f"every vehicle on it{rest}, {settings.max_vehicles} at most"
    yield f"watches    {every if settings.vehicle is None else f'vehicle {settings.vehicle}'}"
    if settings.signing_key is not None:
        read_key(settings.signing_key)
        check_writable(settings.signing_key.with_name("stamp"))  # the time stamp is kept beside it
        yield f"signing    by {settings.signing_key}; unsigned frames are refused"
    if baseline is not None:
        yield f"judges by  {settings.baseline or settings.save}: {_summary(baseline, settings)}"
    elif settings.learn is not None:
        about = f" about {airframe.name}" if airframe else ""
        kept = NOT_KEPT if settings.save is None else f"kept in {settings.save}"
        yield f"learns     from {settings.learn:g} s of healthy flight{about}, {kept}"
    for sysid, known in own.items():
        named = settings.vehicles.get(sysid) if isinstance(sysid, int) else None
        source = named.baseline if named else settings.baselines or "what was learned earlier"
        yield f"vehicle {sysid:<2} by {source}: {_summary(known, settings)}"
    if settings.threshold_scale != 1.0:
        yield f"thresholds times {settings.threshold_scale:g}"
    for rule in parse_rules(settings.on_fault):
        yield f"on fault   {rule}, in {settings.on_fault_modes}"
    kept = "; keeps the rates that it needs" if settings.keep_rates else ""
    for address in settings.forward:
        yield f"forwards   {address}{kept}{_absence(address)}"
    yield from _files_and_ports(settings)


def _files_and_ports(settings: Settings) -> Iterator[str]:
    journal = ("journal", settings.journal, settings.journal_mb, settings.journal_keep)
    record = ("record", settings.record, settings.record_mb, settings.record_keep)
    for option, path, mb, keep in (journal, record):
        if path is not None:
            if not path.is_fifo():
                check_writable(path)
            yield f"{option:<10} {path}, at most {keep + 1} files of {mb:g} MB"
    if settings.history is not None:
        check_installed("--history", "SQLAlchemy", "history")
        flights = settings.flights or Path()  # is made where it is not there
        check_writable(next(one for one in (flights, *flights.absolute().parents) if one.exists()) / "1.json")
        yield f"history    {settings.history}; flights wait in {settings.flights}"
    if settings.metrics is not None:
        yield f"metrics    {Access(*split_address(settings.metrics, 'metrics')).url}metrics"
    if settings.web is not None:
        check_installed("--web", "aiohttp", "web")
        token = None if settings.web_token_file is None else read_token(settings.web_token_file)
        asks = "" if token is None else f"; asks for the token in {settings.web_token_file}"
        yield f"web page   {Access(*split_address(settings.web, 'web'), token).url}{asks}"


def _absence(address: str) -> str:
    try:
        check_address(address)
    except LinkError as error:
        if not address.startswith("/"):  # a device may come later
            raise
        return f"; not now ({error})"
    return ""


def _summary(baseline: Baseline, settings: Settings) -> str:
    judging = len({slot.monitor.name for slot in chain_for(baseline, settings, 0).slots})
    if settings.profile is not None:
        check_link(baseline, profile=settings.profile, dt_s=baseline.link.dt_s)
    link, grade = baseline.link, f", grade {baseline.grade}" if baseline.grade else ""
    return f"{baseline.airframe.name}, {link.profile} at {1 / link.dt_s:.0f} Hz, {judging} monitors{grade}"


def ask_working(metrics: str | None) -> str:
    """Why the daemon that serves its figures there does not work, in one line; empty if it does, whatever vehicles do.

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
        return f"{metrics} does not answer ({error})"
    finally:
        connection.close()
    found = dict(line.split(" ", 1) for line in page.splitlines() if line.startswith("mavdiag_") and " " in line)
    try:
        works, age_s = float(found["mavdiag_session_working"]), float(found["mavdiag_figures_age_seconds"])
    except (KeyError, ValueError):
        return "no figures of a detector that looks at its links"
    if age_s > FRESH_S:
        return f"the loop hangs since {age_s:.0f} s"
    return "" if works else "all sessions are off; the journal says why"
