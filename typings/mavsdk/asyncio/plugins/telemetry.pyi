from collections.abc import AsyncGenerator

from mavsdk.asyncio import System

class Frd:
    forward_m_s2: float
    right_m_s2: float
    down_m_s2: float

class Rates:
    forward_rad_s: float
    right_rad_s: float
    down_rad_s: float

class Imu:
    acceleration_frd: Frd
    angular_velocity_frd: Rates
    timestamp_us: int

class EulerAngle:
    roll_deg: float
    pitch_deg: float
    yaw_deg: float

class StatusText:
    text: str

class Position:
    latitude_deg: float
    longitude_deg: float
    absolute_altitude_m: float
    relative_altitude_m: float

class TelemetryAsync:
    def __init__(self, system: System) -> None: ...
    def subscribe_imu(self) -> AsyncGenerator[Imu, None]: ...
    def subscribe_raw_imu(self) -> AsyncGenerator[Imu, None]: ...
    def subscribe_attitude_euler(self) -> AsyncGenerator[EulerAngle, None]: ...
    def subscribe_armed(self) -> AsyncGenerator[bool, None]: ...
    def subscribe_in_air(self) -> AsyncGenerator[bool, None]: ...
    def subscribe_status_text(self) -> AsyncGenerator[StatusText, None]: ...
    def subscribe_position(self) -> AsyncGenerator[Position, None]: ...
    def subscribe_health_all_ok(self) -> AsyncGenerator[bool, None]: ...
    async def set_rate_imu(self, rate_hz: float) -> int: ...
