"""The table of states: closed, reachable, and drawn as it is."""

import runpy
from pathlib import Path

import pytest

from detector.config import Settings
from detector.session import Session
from detector.states import TABLE, State, Trigger, advance

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_every_state_has_a_row_and_a_handler() -> None:
    assert set(TABLE) == set(State) == set(Session.HANDLERS)


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("trigger", Trigger)
def test_only_what_the_table_lists_is_a_transition(state: State, trigger: Trigger) -> None:
    if trigger in TABLE[state]:
        assert advance(state, trigger) is TABLE[state][trigger]
    else:
        with pytest.raises(ValueError, match=f"no transition from {state.name}"):
            advance(state, trigger)


def test_the_documented_page_is_drawn_from_the_tables() -> None:
    page = runpy.run_path(str(DOCS / "draw_detector_states.py"))["page"]
    assert (DOCS / "detector-states.md").read_text() == page(), "run `python docs/draw_detector_states.py`"


def test_every_setting_is_documented() -> None:
    text = (DOCS / "detector.md").read_text()
    assert [name for name in Settings.model_fields if f"`{name}`" not in text] == []
