"""Write `detector-states.md` from the detector's own tables of states and texts. A test fails when they differ."""

from pathlib import Path

from detector.alerts import POLICY
from detector.states import diagram

PAGE = Path(__file__).parent / "detector-states.md"
TEXT = """# The detector's session

One session runs for each vehicle. This page is drawn from the tables in `detector/states.py` and `detector/alerts.py`
by `python docs/draw_detector_states.py`; do not edit it by hand.

```mermaid
{diagram}```

Heartbeats go out in every state but `faulted`. An alert is raised from `monitoring` only, and ends when no monitor was
above its threshold for a while, or when it can no longer be watched.

## What it says

| about | severity | text | again |
|---|---|---|---|
{texts}
"""


def page() -> str:
    """The whole page."""
    rows = [
        f"| {kind} | {policy.severity.name} | `{policy.template.format('..', '..')}` "
        f"| {'no' if policy.repeat_s is None else f'every {policy.repeat_s:g} s while it lasts'} |"
        for kind, policy in POLICY.items()
    ]
    return TEXT.format(diagram=diagram(), texts="\n".join(rows))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
