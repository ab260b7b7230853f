"""Names of flight modes by the custom_mode of HEARTBEAT: ArduPilot Copter's and PX4's, whose numbers do not meet.

ArduPilot: the number of a mode (AP_Mode, ArduCopter/mode.h). PX4: a main mode in byte 2, a sub mode in byte 3
(px4_custom_mode.h), named as ground stations do.
"""

from collections.abc import Mapping

_COPTER = (
    "stabilize acro alt_hold auto guided loiter rtl circle - land - drift - sport flip autotune poshold brake throw"
)
_COPTER += " avoid_adsb guided_nogps smart_rtl flowhold follow zigzag systemid autorotate auto_rtl turtle"
_PX4 = {(1, 0): "manual", (2, 0): "altitude", (3, 0): "position", (3, 1): "orbit", (3, 2): "position_slow"}
_PX4 |= {(5, 0): "acro", (6, 0): "offboard", (7, 0): "stabilized", (4, 2): "takeoff", (4, 3): "hold"}
_PX4 |= {(4, 4): "mission", (4, 5): "return", (4, 6): "land", (4, 8): "follow", (4, 9): "precision_land"}

MODES: Mapping[int, str] = {
    **{number: name for number, name in enumerate(_COPTER.split()) if name != "-"},
    **{main << 16 | sub << 24: name for (main, sub), name in _PX4.items()},
}


def mode_name(custom_mode: int | None) -> str:
    """The name of a mode, its number where it has none here, "unknown" for None.

    >>> mode_name(5), mode_name(4 << 16 | 4 << 24), mode_name(99), mode_name(None)
    ('loiter', 'mission', '99', 'unknown')
    """
    return "unknown" if custom_mode is None else MODES.get(custom_mode, str(custom_mode))
