class MissionItem:
    x: int
    y: int
    def __init__(
        self,
        seq: int,
        frame: int,
        command: int,
        current: int,
        autocontinue: int,
        param1: float,
        param2: float,
        param3: float,
        param4: float,
        x: int,
        y: int,
        z: float,
        mission_type: int,
    ) -> None: ...
