"""A serial device."""

import termios

from mavdiag.link.ports.base import Reconnecting, Stream, link_error


class Serial(Reconnecting):
    """A serial device, 8N1, held exclusively; opened again when it comes back after having gone.

    absent_ok: whether it may come later. Raises LinkError if it cannot be opened at first and may not.
    """

    def __init__(self, address: str, device: str, baud: int, *, absent_ok: bool = False) -> None:
        super().__init__(address)
        self._device, self._baud = device, baud
        try:
            self._begin()
        except OSError as error:
            if not absent_ok or not error.errno:
                raise link_error(address, error) from error
            self._wait()

    def _open(self) -> Stream:
        import serial  # only if asked for: the import takes its time

        # inter_byte_timeout=0 sets VMIN=1, VTIME=0 (termios): "nothing yet" then differs from "hung up".
        try:
            device = serial.Serial(self._device, self._baud, inter_byte_timeout=0, exclusive=True)
            return Stream(device.fileno(), device.close)
        except termios.error as error:  # it went while it was set up; pyserial lets this out, which is no OSError
            raise OSError(*error.args) from error
        except serial.SerialException as error:
            told = error.errno, error.strerror if error.errno else "this is no serial device: see `ls /dev/tty*`"
            raise OSError(*told) from error
        except ValueError as error:
            raise OSError(0, f"{self._baud} baud is not a speed of this device: try 57600, 115200 or 921600") from error
