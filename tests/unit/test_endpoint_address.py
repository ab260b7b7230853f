"""Addresses: what is understood, and one line of advice for each way to get one wrong."""

import pytest

from mavdiag.errors import LinkError, UsageError
from mavdiag.link.ports import open_endpoint


@pytest.mark.parametrize(
    "text",
    [
        *("", "udpin", "udpin:", "udpin::14550", "udpin:127.0.0.1", "udpin:127.0.0.1:", "udp:127.0.0.1:14550"),
        *("udpin:127.0.0.1:65536", "udpin:127.0.0.1:-1", "udpin:::1:14550", "udpin:127.0.0.1:14550 ", "tcp:[::1:5760"),
        *("udpout:127.0.0.1:0", "tcp:127.0.0.1:0", "/dev/ttyUSB0", "/dev/ttyUSB0,", "/dev/ttyUSB0,0", "ttyUSB0,57600"),
    ],
)
def test_a_malformed_address_is_a_usage_error_of_one_line(text: str) -> None:
    with pytest.raises(UsageError, match="malformed address") as caught:
        open_endpoint(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_a_busy_port_says_so(kind: str) -> None:
    with (
        open_endpoint(f"{kind}:127.0.0.1:0") as holder,
        pytest.raises(LinkError, match="port is busy: stop the program"),
    ):
        open_endpoint(holder.address)


@pytest.mark.parametrize(
    ("address", "advice"),
    [
        ("udpin:192.0.2.1:0", "no such address: use 127.0.0.1"),  # TEST-NET-1 (RFC 5737) is nobody's address
        ("udpout:no-such-host.invalid:14550", "unknown host 'no-such-host.invalid'"),
        ("/dev/no-such-tty,57600", "no such device: plug it in"),
        ("/dev/null,57600", "/dev/null,57600: "),
    ],
)
def test_what_cannot_be_opened_is_a_link_error_of_one_line(address: str, advice: str) -> None:
    with pytest.raises(LinkError, match=advice) as caught:
        open_endpoint(address)
    assert "\n" not in str(caught.value)
