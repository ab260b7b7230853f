"""Who may read the live page: the rules for the address, the headers of a request and the token. Values in and out.

`Host` tells a name that was made to point here (DNS rebinding), `Origin` and `Sec-Fetch-Site` another site's script.
"""

import hashlib
import hmac
import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

PORT_DIGITS = 5
ACKNOWLEDGE, PLAY = POSTED = "/acknowledge", "/play"  # the paths that are posted to: they change something
_LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
_ANYWHERE = ("0.0.0.0", "::")

#: Of every answer. Nothing is loaded from elsewhere, texts cannot become markup (trusted types; `drawing` makes the
#: airframe's SVG), and no other site may frame or read it.
HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types drawing",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Answer(IntEnum):
    """What becomes of a request. The value is the HTTP status."""

    PASS = 200
    SIGN_IN = 303  # the token is right: keep it in a cookie and go on without it in the address
    NO_TOKEN = 401
    REFUSED = 403
    NOT_A_GET = 405


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches a port there.

    >>> [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "drone.local")]
    [True, True, True, False, False]
    """
    return host.lower() == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


@dataclass(frozen=True, slots=True)
class Access:
    """The rules of one server."""

    host: str  # that it listens on
    port: int
    token: str | None = field(default=None, repr=False)  # None where none is asked for
    names: tuple[str, ...] = ()  # under which a proxy serves the page, on a port of its own; it says who may

    @property
    def url(self) -> str:
        """Where to open the page."""
        return f"http://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}/"

    @property
    def cookie(self) -> str:
        """Name of the cookie; cookies are shared by all ports of a host."""
        return f"mavdiag-{self.port}"

    @property
    def cookie_value(self) -> str:
        """What the cookie holds: it proves the token and does not show it."""
        return hmac.new((self.token or "").encode(), self.cookie.encode(), hashlib.sha256).hexdigest()

    def judge(
        self, method: str, path: str, headers: Mapping[str, str], cookie: str | None, given: str | None
    ) -> Answer:
        """What becomes of a request. headers: by their names in lower case. given: the token in the address."""
        host = headers.get("host", "")
        if not self._knows(host) or not self._of_this_page(path, host, headers):
            return Answer.REFUSED
        if method != ("POST" if path in POSTED else "GET"):
            return Answer.NOT_A_GET
        if self.token is None:
            return Answer.PASS
        if given is not None:
            return Answer.SIGN_IN if _same(given, self.token) else Answer.NO_TOKEN
        scheme, _, bearer = headers.get("authorization", "").partition(" ")
        by_cookie = cookie is not None and _same(cookie, self.cookie_value)
        by_bearer = scheme.lower() == "bearer" and _same(bearer.strip(), self.token)
        return Answer.PASS if by_cookie or by_bearer else Answer.NO_TOKEN

    def _knows(self, host: str) -> bool:
        name, digits = _parted(host)
        sound = digits.isdecimal() and digits.isascii() and len(digits) <= PORT_DIGITS
        if self.names:
            return name in map(str.lower, self.names) or _is_address(name)
        known = (self.host.lower(), *(_LOCAL_NAMES if is_loopback(self.host) else ()))
        anywhere = self.host in _ANYWHERE and (name == "localhost" or _is_address(name))
        return sound and int(digits) == self.port and (name in known or anywhere)

    def _of_this_page(self, path: str, host: str, headers: Mapping[str, str]) -> bool:
        """Whether a request comes from this page, the user, or no browser; other sites may link to the page.

        A proxy may serve the page by https, and name another host to us than its own.
        """
        origin, site = headers.get("origin", "").lower(), headers.get("sec-fetch-site", "none")
        scheme, _, place = origin.partition("://")
        served = scheme in ("http", "https") and _parted(place)[0] in map(str.lower, self.names)
        if "origin" in headers and origin != f"http://{host.lower()}" and not served:
            return False
        linked = path == "/" and headers.get("sec-fetch-mode") == "navigate"
        return site in ("none", "same-origin") or linked


def _parted(host: str) -> tuple[str, str]:
    name, colon, digits = host.lower().rpartition(":")
    if not colon or host.endswith("]"):
        name, digits = host.lower(), "80"
    return name.strip("[]"), digits


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _same(given: str, known: str) -> bool:
    # In constant time. A header's bytes that are no UTF-8 are lone surrogates in its text.
    return hmac.compare_digest(given.encode(errors="surrogatepass"), known.encode(errors="surrogatepass"))
