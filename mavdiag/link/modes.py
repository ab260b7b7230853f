"""Names of flight modes by the custom_mode of HEARTBEAT: ArduPilot Copter's and PX4's, whose numbers do not meet.

ArduPilot: the number of a mode (AP_Mode, ArduCopter/mode.h). PX4: a main mode in byte 2, a sub mode in byte 3
(px4_custom_mode.h), named as ground stations do; its logs tell the navigation state instead (VehicleStatus.msg).
"""

from collections.abc import Mapping

import numpy as np

from mavdiag.telemetry import FloatArray

_COPTER = (
    "stabilize acro alt_hold auto guided loiter rtl circle - land - drift - sport flip autotune poshold brake throw"
)
_COPTER += " avoid_adsb guided_nogps smart_rtl flowhold follow zigzag systemid autorotate auto_rtl turtle"
# Main mode, sub mode, navigation state.
_PX4 = {"manual": (1, 0, 0), "altitude": (2, 0, 1), "position": (3, 0, 2), "orbit": (3, 1, 21)}
_PX4 |= {"position_slow": (3, 2, 6), "acro": (5, 0, 10), "offboard": (6, 0, 14), "stabilized": (7, 0, 15)}
_PX4 |= {"takeoff": (4, 2, 17), "hold": (4, 3, 4), "mission": (4, 4, 3), "return": (4, 5, 5), "land": (4, 6, 18)}
_PX4 |= {"follow": (4, 8, 19), "precision_land": (4, 9, 20)}

MODES: Mapping[int, str] = {
    **{number: name for number, name in enumerate(_COPTER.split()) if name != "-"},
    **{main << 16 | sub << 24: name for name, (main, sub, _) in _PX4.items()},
}


def mode_name(custom_mode: int | None) -> str:
    """The name of a mode, its number where it has none here, "unknown" for None.

    >>> mode_name(5), mode_name(4 << 16 | 4 << 24), mode_name(99), mode_name(None)
    ('loiter', 'mission', '99', 'unknown')
    """
    return "unknown" if custom_mode is None else MODES.get(custom_mode, str(custom_mode))


def px4_custom_mode(nav_state: FloatArray) -> FloatArray:
    """The custom_mode that PX4 sends in each navigation state, (n, 1); NaN for one without a name here.

    >>> [mode_name(int(mode)) for mode in px4_custom_mode(np.array([[3.0], [15.0]]))[:, 0]]
    ['mission', 'stabilized']
    """
    found = np.full(nav_state.shape, np.nan)
    for main, sub, state in _PX4.values():
        found[nav_state == state] = main << 16 | sub << 24
    return found
