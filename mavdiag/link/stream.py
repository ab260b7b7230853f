"""One vehicle's frames to telemetry, on one clock, with the IMU message that it really sends."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from mavdiag.link.clock import VehicleTime
from mavdiag.link.codec import Frame
from mavdiag.link.messages import Component
from mavdiag.link.parameters import with_parameters
from mavdiag.link.profiles import IMU_MESSAGES, LAST_RESORT, Profile, by_attitude, with_imu
from mavdiag.link.samples import SampleDecoder, SampleState
from mavdiag.telemetry import Signal, Telemetry
from mavdiag.units import NS_PER_S

CLEAR_FRAMES = 512  # of a vehicle that are enough to see its profile (our choice)
LAST_RESORT_S = 30.0  # without any IMU message, before the rates of ATTITUDE are read instead (our choice)
USEFUL_FRAMES = 20  # of an IMU message, before it is taken at once (our choice)
CHOICE_S = 1.0  # for which the choice stays open otherwise, from the first IMU message of any kind on (our choice)


class VehicleStream:
    """One vehicle's frames to telemetry, on one clock.

    profile: how it sends; while no gyro sample has come, its IMU message is replaced by another that does come.
    signals: those of interest.
    parameters: of its autopilot that passed by so far, by name.
    """

    def __init__(self, profile: Profile, signals: Collection[Signal] = tuple(Signal)) -> None:
        self._signals = signals
        self._decoder = SampleDecoder(profile, signals)
        self._state = SampleState()
        self._own, self._since_ns = profile, 0
        self._imu: list[Frame] = []
        self._settled = False  # whether the IMU message is chosen for good
        self.parameters: Mapping[str, float] = {}

    @property
    def profile(self) -> Profile:
        """The profile, with the IMU message that is read."""
        return self._decoder.profile

    @property
    def timeline(self) -> VehicleTime:
        """Where the vehicle's time stands."""
        return self._state.timeline

    @property
    def vehicle_ns(self) -> int | None:
        """Latest time of the vehicle's clock [ns], None before its first stamp."""
        return self._state.timeline.t_ns

    @property
    def reboots(self) -> int:
        """How often it started anew."""
        return self._state.timeline.reboots

    @property
    def dropped(self) -> int:
        """Samples left out for NaN, infinity or a zero quaternion so far."""
        return self._state.dropped

    @property
    def leaps(self) -> int:
        """Samples left out because their stamps leap, so far."""
        return self._state.leaps

    @property
    def contrary(self) -> int:
        """Disarmed heartbeats amid armed ones, left out so far."""
        return self._state.contrary

    def step(self, frames: Sequence[Frame]) -> Telemetry:
        """Take the vehicle's next frames, in order of arrival."""
        if not self._settled:
            self._choose_imu(frames)
        self.parameters = with_parameters(self.parameters, frames, self.profile.autopilot)
        self._state, telemetry = self._decoder.step(self._state, frames)
        return telemetry

    def _choose_imu(self, frames: Sequence[Frame]) -> None:
        found = (frame for frame in frames if frame.msgid in IMU_MESSAGES and frame.compid == Component.AUTOPILOT1)
        self._imu = [*self._imu, *found][-CLEAR_FRAMES:]
        chosen = with_imu(self._own, self._imu, USEFUL_FRAMES)
        self._since_ns = self._since_ns or next((frame.host_ns for frame in frames), 0)
        waited_ns = frames[-1].host_ns - self._since_ns if frames else 0
        if not self._imu and (waited_ns > LAST_RESORT_S * NS_PER_S or self.profile.imu == LAST_RESORT):
            chosen = by_attitude(self._own)
        if chosen.imu != self.profile.imu:
            self._decoder = SampleDecoder(chosen, self._signals)
        counts = Counter(frame.msgid for frame in self._imu)
        told_s = (self._imu[-1].host_ns - self._imu[0].host_ns) / NS_PER_S if self._imu else 0.0
        self._settled = counts[chosen.imu] >= USEFUL_FRAMES or (counts[chosen.imu] > 0 and told_s >= CHOICE_S)
        if self._settled:
            self._imu = []
