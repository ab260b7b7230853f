"""Who may read the live page: by the address it is on, the headers of a request, and the token."""

from collections.abc import Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector.config import load_settings
from detector.web.access import Access, Answer
from detector.web.child import read_token
from mavdiag.errors import UsageError

LOCAL = Access("127.0.0.1", 8080)
BEHIND = Access("0.0.0.0", 8080, names=("blueos.local",))
OPEN = Access("0.0.0.0", 8080, "a-token-of-24-characters")


def judged(access: Access, path: str = "/stream", method: str = "GET", token: str | None = None, **more: str) -> Answer:
    headers = {"host": "127.0.0.1:8080"} | {name.replace("_", "-"): value for name, value in more.items()}
    return access.judge(method, path, headers, headers.pop("cookie", None), token)


@given(st.text(max_size=40).filter(lambda text: text.lower() not in ("127.0.0.1:8080", "localhost:8080", "[::1]:8080")))
def test_every_other_host_is_refused(host: str) -> None:
    if host.lower().strip() != "::1:8080":  # no name: nothing can be rebound to it
        assert judged(LOCAL, host=host) is Answer.REFUSED


@pytest.mark.parametrize(
    ("headers", "path", "answer"),
    [
        ({"origin": "http://127.0.0.1:8080"}, "/stream", Answer.PASS),
        ({"origin": "http://evil.example"}, "/stream", Answer.REFUSED),
        ({"origin": "null"}, "/stream", Answer.REFUSED),
        ({"origin": "https://127.0.0.1:8080"}, "/stream", Answer.REFUSED),
        ({"sec_fetch_site": "same-origin"}, "/stream", Answer.PASS),
        ({"sec_fetch_site": "cross-site"}, "/stream", Answer.REFUSED),
        ({"sec_fetch_site": "same-site"}, "/stream", Answer.REFUSED),
        ({"sec_fetch_site": "cross-site", "sec_fetch_mode": "no-cors"}, "/app.js", Answer.REFUSED),
        ({"sec_fetch_site": "cross-site", "sec_fetch_mode": "navigate"}, "/", Answer.PASS),
        ({"sec_fetch_site": "cross-site", "sec_fetch_mode": "navigate"}, "/stream", Answer.REFUSED),
    ],
)
def test_another_sites_script_is_refused(headers: Mapping[str, str], path: str, answer: Answer) -> None:
    assert judged(LOCAL, path, **headers) is answer


@pytest.mark.parametrize(
    ("host", "answer"),
    [
        ("blueos.local", Answer.PASS),
        ("BlueOS.local:80", Answer.PASS),
        ("192.168.2.2", Answer.PASS),  # an address cannot be made to point elsewhere
        ("127.0.0.1:9192", Answer.PASS),
        ("evil.example", Answer.REFUSED),
        ("blueos.local.evil.example", Answer.REFUSED),
        ("localhost", Answer.REFUSED),
    ],
)
def test_behind_a_proxy_its_names_are_known(host: str, answer: Answer) -> None:
    assert judged(BEHIND, host=host) is answer
    assert judged(BEHIND, "/acknowledge", "POST", host=host, origin=f"http://{host}") is answer
    assert judged(BEHIND, "/acknowledge", "POST", host=host, origin="http://evil.org") is Answer.REFUSED


def test_the_token_is_asked_for_everywhere() -> None:
    assert judged(OPEN, "/") is Answer.NO_TOKEN
    assert judged(OPEN, "/", token="wrong") is Answer.NO_TOKEN
    assert judged(OPEN, "/", token=OPEN.token) is Answer.SIGN_IN
    assert judged(OPEN, "/app.js", cookie=OPEN.cookie_value) is Answer.PASS
    assert judged(OPEN, "/app.js", cookie=OPEN.token or "") is Answer.NO_TOKEN
    assert judged(OPEN, authorization=f"bearer {OPEN.token}") is Answer.PASS
    assert judged(OPEN, authorization=f"Basic {OPEN.token}") is Answer.NO_TOKEN
    assert judged(OPEN, "/", token="ü" * 24) is Answer.NO_TOKEN
    assert (OPEN.token or "") not in repr(OPEN) + OPEN.cookie_value


@pytest.mark.parametrize("web", ["0.0.0.0:8080", "192.168.1.7:8080", "drone.local:8080", "[::]:8080"])
def test_elsewhere_than_on_loopback_a_token_is_needed(web: str) -> None:
    with pytest.raises(UsageError, match=r"name a --web-token-file FILE, or 127\.0\.0\.1$"):
        load_settings(None, {"learn": 9.0, "save": "b.json", "web": web})
    assert load_settings(None, {"learn": 9.0, "save": "b.json", "web": web, "web_token_file": "t"}).web == web


@given(st.text(st.characters(codec=None), max_size=20), st.sampled_from(["authorization", "cookie", "host", "token"]))
def test_no_header_leaves_the_rules_by_an_exception(text: str, where: str) -> None:
    for value in (text, f"Bearer {text}", "\udcff", f"127.0.0.1:{'8' * 5000}"):
        headers = {"host": "127.0.0.1:8080", where: value}
        given = value if where == "token" else None
        cookie = headers.pop("cookie", None)
        assert OPEN.judge("GET", "/", headers, cookie, given) in (Answer.NO_TOKEN, Answer.REFUSED)


@pytest.mark.parametrize(
    ("content", "mode", "words"),
    [
        ("short\n", 0o600, "16 or more ASCII characters"),
        ("long enough but with blanks\n", 0o600, "without blanks"),
        ("0123456789abcdef\n", 0o644, "others may read the web token; run `chmod 600"),
    ],
)
def test_a_token_file_keeps_the_rules_of_a_key_file(tmp_path: Path, content: str, mode: int, words: str) -> None:
    path = tmp_path / "token"
    path.write_text(content)
    path.chmod(mode)
    with pytest.raises(UsageError) as error:
        read_token(path)
    assert words in str(error.value)
    assert len(str(error.value).splitlines()) == 1
