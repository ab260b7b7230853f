"""Write `detector-states.md` from the detector's own tables of states and texts. A test fails when they differ."""

from pathlib import Path

from detector.alerts import Kind, Policy
from detector.states import TABLE, State, Trigger

PAGE = Path(__file__).parent / "detector-states.md"
TEXT = """# The detector's session

One session runs for each vehicle. `python docs/draw_detector_states.py` draws this page from `detector/states.py` and
`detector/alerts.py`.

```mermaid
{diagram}```

From every state {broken} leads to `{faulted}`. Heartbeats go out in every other state. What is found of the vehicle is
the decision's stage (not judged, quiet, suspected, fault, inspect), no state of the session.

## What it says

| severity | text | said again while it lasts |
|---|---|---|
{texts}
"""


def diagram() -> str:
    """The table of states as a Mermaid state diagram."""
    lines = ["stateDiagram-v2", f"    [*] --> {State.WAITING}"]
    for state, row in TABLE.items():
        drawn = {trigger: target for trigger, target in row.items() if trigger is not Trigger.BROKEN}
        lines += [f"    {state} --> {target}: {trigger}" for trigger, target in drawn.items()]
    return "\n".join(lines) + "\n"


def page() -> str:
    """The whole page."""
    policies = [kind.value for kind in Kind]
    rows = [f"| {one.severity.name} | `{one.template.format('..', '..')}` | {_again(one)} |" for one in policies]
    return TEXT.format(diagram=diagram(), broken=Trigger.BROKEN, faulted=State.FAULTED, texts="\n".join(rows))


def _again(policy: Policy) -> str:
    """When a lasting matter is said again."""
    if not policy.again_s:
        return "no"
    *first, last = policy.again_s
    every = f"every {last - (first[-1] if first else 0.0):g} s"
    return f"{', '.join(f'{time_s:g}' for time_s in first)} s, then {every}" if first else every


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
