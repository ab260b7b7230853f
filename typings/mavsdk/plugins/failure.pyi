from enum import IntEnum

class FailureUnit(IntEnum):
    SYSTEM_MOTOR = 101

class FailureType(IntEnum):
    OK = 0
    SLOW = 5
