"""Shared set-up: hypothesis is reproducible and prints how to repeat a failure; each test keeps its own answers."""

import itertools
from collections.abc import Callable

import pytest
from hypothesis import settings

settings.register_profile("repo", deadline=None, print_blob=True, derandomize=True, max_examples=60)
settings.load_profile("repo")

NUMBERS = itertools.count()
Ran = tuple[int, str, str]


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Answers of scans are kept in a folder of this test, which is made when it is needed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / f"cache-{next(NUMBERS)}"))


@pytest.fixture
def mavdiag(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """The program, run in this process: exit code, stdout, stderr."""
    from mavdiag import cli

    def run(*arguments: object) -> Ran:
        monkeypatch.setattr("sys.argv", ["mavdiag", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        out, err = capsys.readouterr()
        return int(str(caught.value.code)), out, err

    return run
