"""Taking a payload up in flight, and dropping it: the rigid body changes from one step to the next.

With mass m, velocity v of the centre of gravity, inertia I about it, payload m_p at d from the old centre:

    own speed:  the payload already moves as the vehicle does.    v' = v + omega × shift,  omega' = omega
    at rest:    it hangs still and is snatched (plastic impact).   m' v' = m v,   I' omega' = I omega - mu d × v

mu = m m_p / (m + m_p), shift is the way of the centre of gravity. A dropped payload leaves with its own speed, so
nothing jerks. Momentum is kept in all cases, as far as payload and vehicle exchange it. The rotors keep their speed.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.airframe import Airframe, Payload
from sitl_plant.physics.dynamics import rotate_to_body, rotate_to_world
from sitl_plant.physics.kernel import Model, State
from sitl_plant.physics.parameters import body_with_payload

__all__ = ["PickUp", "carried", "reload"]


@dataclass(frozen=True, slots=True)
class PickUp:
    """A payload that is taken up at `at_s` of flight time and dropped at `drop_s`.

    before: how the payload moves until then: "own" as the vehicle does, "rest" not at all.
    """

    payload: Payload = field(default_factory=Payload)
    at_s: float = 10.0
    drop_s: float = math.inf
    before: Literal["own", "rest"] = "own"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.at_s) and 0.0 < self.at_s < self.drop_s):
            raise UsageError(f"a pick-up must be after the start and before the drop, not at {self.at_s:g} s")
        if self.before not in ("own", "rest"):
            raise UsageError(f"before a pick-up a payload moves as 'own' or 'rest', not {self.before!r}")

    def span(self, dt_s: float) -> tuple[int, int | None]:
        """First step with the payload, and first step without it again."""
        return round(self.at_s / dt_s), None if math.isinf(self.drop_s) else round(self.drop_s / dt_s)


def carried(pickup: PickUp | None, step: int, dt_s: float) -> bool:
    """Whether the payload hangs on the vehicle in this step."""
    if pickup is None:
        return False
    first, end = pickup.span(dt_s)
    return first <= step and (end is None or step < end)


def reload(
    model: Model, state: State, airframe: Airframe, payloads: tuple[Payload, ...], taken: PickUp | None = None
) -> Model:
    """The model with these payloads on the airframe; `state` is changed to that of the new centre of gravity.

    taken: the pick-up that happens now; None if something was dropped. Model and state keep their geometric centre.
    """
    body, centre = body_with_payload(airframe, *payloads)
    shift = centre + model.mocap.centre  # mocap.centre is the way back to the geometric centre
    if taken is not None and taken.before == "rest":
        apart = np.asarray(taken.payload.position_m) + model.mocap.centre
        _snatch(state.rigid, model, body.inverse, taken.payload.mass_kg, apart)
    else:
        _move_by(state.rigid, slice(3, 6), np.cross(state.rigid[10:13], shift))
    _move_by(state.rigid, slice(0, 3), shift)
    state.wrench[:, 3:6] -= np.cross(shift, state.wrench[:, :3])
    ground = model.ground
    if len(ground.gear):
        gear = ground.gear - shift
        ground = ground._replace(gear=gear, reach=ground.level - float(np.linalg.norm(gear, axis=1).max()))
    return model._replace(
        body=body,
        ground=ground,
        rotors=model.rotors._replace(hub=model.rotors.hub - shift),
        imu=model.imu._replace(position=model.imu.position - shift),
        mocap=model.mocap._replace(centre=-centre),
    )


def _snatch(rigid: FloatArray, model: Model, inverse: FloatArray, mass: float, apart: FloatArray) -> None:
    """Plastic impact with a point mass at rest, `apart` from the old centre of gravity."""
    own = model.body.mass
    v_B = np.array(rotate_to_body(rigid, rigid[3], rigid[4], rigid[5]))
    reduced = own * mass / (own + mass)
    rigid[10:13] = inverse @ (model.body.inertia @ rigid[10:13] - reduced * np.cross(apart, v_B))
    rigid[3:6] *= own / (own + mass)


def _move_by(rigid: FloatArray, place: slice, way_B: FloatArray) -> None:
    """Add a body vector to a world vector of the state row."""
    x, y, z = way_B.tolist()
    rigid[place] += rotate_to_world(rigid, x, y, z)
