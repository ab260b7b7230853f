"""Write `detector-states.md`: the detector's session as its own table has it. A test fails when they differ."""

from pathlib import Path

from detector.states import diagram

PAGE = Path(__file__).parent / "detector-states.md"
TEXT = """# The detector's session

One session runs for each vehicle. This picture is drawn from the table in `detector/states.py` by
`python docs/draw_detector_states.py`; do not edit it by hand.

```mermaid
{diagram}```

Heartbeats go out in every state but `faulted`. An alert is raised from `monitoring` only, and ends when no monitor was
above its threshold for a while, or when it can no longer be watched.
"""


if __name__ == "__main__":
    PAGE.write_text(TEXT.format(diagram=diagram()), encoding="utf-8")
