"""Which kinds of vehicle are judged: multirotors, by MAV_TYPE of the MAVLink common dialect.

Every figure of a monitor rests on fixed rotors that carry the vehicle all the time. A vehicle of another kind is
refused before anything is made of its samples; a VTOL too, for its rotors stop, tilt or idle in forward flight, and
nothing here tells those parts apart. A vehicle that does not say what it is, or says "generic", is taken for a
multirotor.
"""

GENERIC, QUAD = 0, 2
#: Generic, quad, coaxial, hexa, octo, tri, dodeca, deca, and "multirotor" without a number of rotors.
MULTIROTORS = frozenset({GENERIC, QUAD, 3, 13, 14, 15, 29, 35, 43})

_NAMES = {
    1: "a plane",
    4: "a helicopter",
    5: "an antenna tracker",
    7: "an airship",
    8: "a balloon",
    9: "a rocket",
    10: "a rover",
    11: "a boat",
    12: "a submarine",
    16: "a flapping wing",
    17: "a kite",
    **dict.fromkeys((*range(19, 26), 47), "a VTOL"),
    28: "a parafoil",
    37: "a parachute",
    45: "a spacecraft",
    46: "a walking robot",
}


def refusal(mav_type: int | None) -> str:
    """Why a vehicle of this MAV_TYPE is not judged, one sentence; empty if it may be judged. None: it is not known.

    >>> refusal(11), refusal(2), refusal(None)
    ('a boat (MAV_TYPE 11): mavdiag judges multirotors only', '', '')
    """
    if mav_type is None or mav_type in MULTIROTORS:
        return ""
    return f"{_NAMES.get(mav_type, 'no multirotor')} (MAV_TYPE {mav_type}): mavdiag judges multirotors only"
