"""Shared set-up: hypothesis is reproducible and prints how to repeat a failure; each test keeps its own answers."""

import gc
import itertools
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from typing import Any

import pytest
from hypothesis import settings

settings.register_profile("repo", deadline=None, print_blob=True, derandomize=True, max_examples=30)
settings.load_profile("repo")

NUMBERS = itertools.count()
gc.disable()  # until all tests are collected: to go through what is loaded again and again was half of that time
Ran = tuple[int, str, str]


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Answers of scans are kept in a folder of this test, which is made when it is needed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / f"cache-{next(NUMBERS)}"))


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """A program of this project, run in this process: exit code, stdout, stderr. It is named by its module."""

    def run(module: str, *arguments: object) -> Ran:
        monkeypatch.setattr("sys.argv", [module, *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            import_module(module).main()
        out, err = capsys.readouterr()
        return int(str(caught.value.code)), out, err

    return run


@pytest.fixture
def mavdiag(program: Callable[..., Ran]) -> Callable[..., Ran]:
    """`program` of the library's own."""
    return partial(program, "mavdiag.cli")


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with import_module("web_page").browser(tmp_path_factory.mktemp("chromium") / "profile") as driver:
        yield driver
