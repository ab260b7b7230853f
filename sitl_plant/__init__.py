"""A software-in-the-loop QDrone 2: flight dynamics, control, sensors and propeller faults, seen over MAVLink.

    trajectory ▶ controller ▶ mixer ▶ rotors × faults ▶ rigid body ▶ sensors ▶ attitude estimate ┐
         ▲                                                                └─ motion capture ─────┤
         └───────────────────────────────────────────────────────────────────────────────────────┘

`sitl_plant.plant` has the one class to use, `Plant`. It needs numba: install `mavdiag[plant]`.
"""

__all__: list[str] = []
