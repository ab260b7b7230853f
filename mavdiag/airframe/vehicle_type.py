"""Which kinds of vehicle are judged: multirotors, by MAV_TYPE of the MAVLink common dialect.

A VTOL is refused too, for its rotors stop, tilt or idle in forward flight. One that does not say what it is, or says
"generic", is taken for a multirotor.
"""

GENERIC, QUAD = 0, 2
#: Generic, quad, coaxial, hexa, octo, tri, dodeca, deca, and "multirotor" without a number of rotors.
MULTIROTORS = frozenset({GENERIC, QUAD, 3, 13, 14, 15, 29, 35, 43})

_NAMES = {1: "a plane", 4: "a helicopter", 5: "an antenna tracker", 10: "a rover", 11: "a boat", 12: "a submarine"}
_NAMES |= dict.fromkeys((*range(19, 26), 47), "a VTOL")


def refusal(mav_type: int | None) -> str:
    """Say in one sentence why a vehicle of this MAV_TYPE is not judged; empty if it may be. None: it is not known.

    >>> refusal(11), refusal(2), refusal(None)
    ('a boat (MAV_TYPE 11): mavdiag judges multirotors only', '', '')
    """
    if mav_type is None or mav_type in MULTIROTORS:
        return ""
    return f"{_NAMES.get(mav_type, 'no multirotor')} (MAV_TYPE {mav_type}): mavdiag judges multirotors only"
