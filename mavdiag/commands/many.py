"""Many logs judged, with progress: what `mavdiag scan` and `mavdiag history add` have in common."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

from mavdiag.archive.job import Answer, Cache, Question, cache_folder, open_cache
from mavdiag.archive.paths import Named
from mavdiag.archive.pool import TaskExecutor, dask_executor, in_this_process, local_executor
from mavdiag.archive.scan import scan
from mavdiag.commandline import say
from mavdiag.commands.progress import shown, sizes_of
from mavdiag.errors import UsageError


class How(NamedTuple):
    """Who judges, and where answers are kept: the options of both commands, as they came."""

    jobs: int | None
    scheduler: str | None
    cache: Path | None
    no_cache: bool


@contextmanager
def judging(
    logs: Sequence[Named], question: Question, how: How, *, quiet: bool = False
) -> Iterator[tuple[Iterator[Answer], Callable[[str], None]]]:
    """The answers in order, and what prints lines beside the progress. quiet: no progress where no terminal is."""
    kept = None if how.no_cache else _cache(how.cache, question.scope)
    sizes = sizes_of(log.path for log in logs)
    with shown("judged", sizes, quiet=quiet) as progress:

        def counted() -> Iterator[Answer]:
            for answer, size in zip(run, sizes, strict=True):
                progress.add(size)
                yield answer

        warn = partial(progress.say, err=True)
        with closing(scan(logs, question, _opened(how, len(logs)), kept, warn)) as run:
            yield counted(), progress.say


def _opened(how: How, logs: int) -> Callable[[], AbstractContextManager[TaskExecutor]]:
    if how.scheduler is not None:
        return partial(dask_executor, how.scheduler)
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    jobs = min(how.jobs or processors, logs)
    return partial(local_executor, jobs) if jobs > 1 else in_this_process


def _cache(folder: Path | None, scope: str) -> Cache | None:
    """Only a folder that was asked for must be usable."""
    chosen = cache_folder() if folder is None else folder
    try:
        return None if chosen is None else open_cache(chosen, scope)
    except UsageError as error:
        if folder is not None:
            raise
        say(f"answers are not kept: {error}", err=True)
        return None
