"""The short form of benchmarks/reactions.py: a damaged vehicle is flown home by the detector, or is let alone."""

from reactions import fly


def test_a_mission_with_a_crack_is_flown_home_after_the_delay_and_a_call_off_lets_it_go_on() -> None:
    flown = fly("mission", 100, "F2/SV3")
    assert flown.commands == ["rtl"]
    assert flown.announced
    assert flown.late_s is not None
    assert -0.01 <= flown.late_s <= 0.5
    assert flown.down
    left = fly("mission", 101, "F2/SV3", call="stick", until_s=50.0)
    assert left.called_off
    assert left.commands == []
    assert not left.down


def test_a_healthy_mission_is_left_alone() -> None:
    flown = fly("mission", 102, until_s=40.0)
    assert (flown.commands, flown.announced, flown.declared_s) == ([], False, None)
    assert flown.judged > 0.5
