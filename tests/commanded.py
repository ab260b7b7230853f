"""A commanded vehicle in virtual time: commands in, answers and a flight out."""

from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.layout import Argument
from mavdiag.link.messages import MessageId
from sitl_plant.autopilot.commands import Autopilot
from sitl_plant.autopilot.dialect import Mode, dialect_named
from sitl_plant.autopilot.wire import Action, Reply
from sitl_plant.emulator import obey
from sitl_plant.plant import Plant, PlantConfig, PlantSamples

PLANT = (1, 1)
BLOCK_STEPS = 20


class Vehicle:
    """The emulator without its links: one ground station, 255/190, talks to it on link 0."""

    def __init__(self, profile: str = "px4", seed: int = 3) -> None:
        config = PlantConfig(trajectory="commanded", start="ground", seed=seed)
        self._dialect = dialect_named(profile)
        self.plant = Plant(config)
        self.autopilot = Autopilot([self._dialect.schedule(None)], self._dialect, config)
        self.said: list[Reply] = []
        self.flown: list[PlantSamples] = []
        self._encoder = Encoder(255, 190)
        self.fly(0.1)

    @property
    def now(self) -> PlantSamples:
        """The latest samples."""
        return self.flown[-1]

    @property
    def place(self) -> tuple[float, float, float]:
        """Where it is, world NED."""
        north, east, down = self.now.position[-1].tolist()
        return north, east, down

    @property
    def armed(self) -> bool:
        """Whether the motors are on."""
        return bool(self.now.motors[-1])

    def code(self, mode: Mode) -> int:
        """The custom_mode of a mode."""
        return self._dialect.shown(mode)

    def send(self, msgid: int, *fields: Argument) -> list[Reply]:
        """Give it a message; its answers."""
        frame = Decoder().feed(self._encoder.encode(msgid, *fields), 0)[0]
        return self._note(self.autopilot.step(0, frame, self.plant.t_ns))

    def order(self, command: int, *parameters: float) -> int:
        """The result of a COMMAND_LONG."""
        [ack, *_] = self.send(MessageId.COMMAND_LONG, *PLANT, command, 0, *parameters)
        assert ack.msgid == MessageId.COMMAND_ACK
        result = ack.fields[1]
        assert isinstance(result, int)
        return result

    def fly(self, seconds: float) -> PlantSamples:
        """Fly on; the last block."""
        for _ in range(round(seconds * 1000 / BLOCK_STEPS)):
            samples = self.plant.advance(BLOCK_STEPS)
            self.flown.append(samples)
            actions, orders = self.autopilot.watch(samples)
            self._note(actions)
            for order in orders:
                obey(self.plant, order)
        return self.now

    def _note(self, actions: list[Action]) -> list[Reply]:
        replies = [action for action in actions if isinstance(action, Reply)]
        self.said += replies
        return replies
