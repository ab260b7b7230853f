"""The table of states: closed, reachable, and drawn as it is."""

import runpy
from pathlib import Path

from detector.config import Settings
from detector.session import Session
from detector.states import TABLE, State

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_every_state_has_a_row_and_a_handler() -> None:
    assert set(TABLE) == set(State)
    assert [state for state in State if not hasattr(Session, f"_{state}")] == [State.LOST]


def test_the_documented_page_is_drawn_from_the_tables() -> None:
    page = runpy.run_path(str(DOCS / "draw_detector_states.py"))["page"]
    assert (DOCS / "detector-states.md").read_text() == page(), "run `python docs/draw_detector_states.py`"


def test_every_setting_is_documented() -> None:
    text = (DOCS / "detector.md").read_text()
    assert [name for name in Settings.model_fields if f"`{name}`" not in text] == []
