from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

class ULogException(Exception): ...
class ULogIncompatibleFlagException(ULogException): ...

class ULog:
    class Data:
        name: str
        multi_id: int
        data: dict[str, NDArray[np.number]]

    class MessageFormat:
        name: str
        fields: list[tuple[str, int, str]]

    class MessageDropout:
        duration: int
        timestamp: int

    def __init__(
        self,
        log_file: str | BinaryIO,
        message_name_filter_list: list[str] | None = None,
        disable_str_exceptions: bool = True,
        parse_header_only: bool = False,
    ) -> None: ...
    @property
    def start_timestamp(self) -> int: ...
    @property
    def last_timestamp(self) -> int: ...
    @property
    def message_formats(self) -> dict[str, MessageFormat]: ...
    @property
    def initial_parameters(self) -> dict[str, float]: ...
    @property
    def changed_parameters(self) -> list[tuple[int, str, float]]: ...
    @property
    def dropouts(self) -> list[MessageDropout]: ...
    @property
    def data_list(self) -> list[Data]: ...
    @property
    def file_corruption(self) -> bool: ...
