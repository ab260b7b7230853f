"""Many logs judged, with progress: what `mavdiag scan` and `mavdiag history add` have in common."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

from mavdiag.archive.job import Cache, Question, open_cache
from mavdiag.archive.paths import Named
from mavdiag.archive.scan import Answer, scan
from mavdiag.commands.progress import shown, sizes_of


@contextmanager
def judging(
    logs: Sequence[Named],
    question: Question,
    workers: int | str | None,
    cache: Path | None,
    *,
    no_cache: bool,
    quiet: bool = False,
) -> Iterator[tuple[Iterator[Answer], Callable[[str], None]]]:
    """The answers in order, and what prints lines beside the progress. quiet: no progress where no terminal is."""
    sizes = sizes_of(log.path for log in logs)
    with shown("judged", sizes, quiet=quiet) as progress:
        warn = partial(progress.say, err=True)
        kept = Cache() if no_cache else open_cache(cache, question.scope, warn)
        chosen = workers if isinstance(workers, str) else min(workers or os.cpu_count() or 1, len(logs))

        def counted() -> Iterator[Answer]:
            for answer, size in zip(run, sizes, strict=True):
                progress.add(size)
                yield answer

        with closing(scan(logs, question, chosen, kept, warn)) as run:
            yield counted(), progress.say
