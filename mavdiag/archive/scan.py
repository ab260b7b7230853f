"""Many logs to answers (edge): each content judged once, by several workers; each log answered once, in their order.

    logs ─ mark ─▶ seen? ─ yes ─ digest ─▶ known? ─ yes ─▶ answer
                     └─ no ─────────────────┴─ no ─ judge ─▶ keep ─▶ answers of all logs with this content

The mark is of a file's size and ends, so it costs nothing; a log that shares it with no other is read only once.
A log that cannot be read is answered as an error; so is one whose judging ends its worker. Nothing else is lost by it.
"""

from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import AbstractContextManager
from functools import cache as memoise

from mavdiag.archive.job import Answer, Cache, Question, Record, digest_of, judge_file, mark_of, refused
from mavdiag.archive.paths import Named
from mavdiag.archive.pool import TaskExecutor
from mavdiag.errors import InputError, LinkError, MavdiagError, UsageError

QUIET_S = 15.0  # without an answer, until it is looked whether there is any worker (our choice)
MOST_IDLE = 3  # times that workers may die without work (our choice)
DIED = "the process that judged it died, perhaps for want of memory; judge it alone, or a part of it (--from, --to)"


def scan(
    logs: Sequence[Named],
    question: Question,
    opened: Callable[[], AbstractContextManager[TaskExecutor]],
    cache: Cache | None = None,
    warn: Callable[[str], None] = lambda text: None,
) -> Generator[Answer, None, None]:
    """The answers in the order of the logs, each as soon as it and all before it are there.

    opened: opens the workers, if any log must be judged; again if a worker died.
    cache: answers from before, and where new ones are kept as they come.
    warn: is told once if they cannot be kept, and if no worker is left.
    Raises UsageError or LinkError if the workers cannot go on.
    """
    return _Scan(logs, question, cache, warn).answers(opened)


class _Scan:
    """What is still to be done, what is being done, and who waits for whose answer; logs go by their numbers."""

    def __init__(
        self, logs: Sequence[Named], question: Question, cache: Cache | None, warn: Callable[[str], None]
    ) -> None:
        self._logs, self._question, self._cache, self._warn = logs, question, cache, warn
        self._marks = [mark_of(log.path) for log in logs]
        seen = {mark for mark, count in Counter(self._marks).items() if count > 1}
        seen |= frozenset() if cache is None else cache.marks()
        doubtful = [mark in seen and not log.trouble for mark, log in zip(self._marks, logs, strict=True)]
        self._digest = memoise(lambda number: digest_of(logs[number].path) if doubtful[number] else "")
        self._todo = deque(range(len(logs)))
        self._suspects = set[int]()  # one of them ended a worker: each is judged alone
        self._running = dict[Future[Record], int]()
        self._copies = dict[str, list[int]]()  # logs that wait for the answer of a content, by its digest
        self._known = dict[str, Record]()  # answers that are not in the cache, by digest
        self._deserted = False  # no worker is left, and that was told
        self._answers = dict[int, Answer]()  # that wait for those before them
        self._yielded = 0

    def answers(self, opened: Callable[[], AbstractContextManager[TaskExecutor]]) -> Generator[Answer, None, None]:
        idle = 0
        while self._todo:
            if self._is_answered(self._todo[0]):
                self._todo.popleft()
                yield from self._ready()
                continue
            try:
                with opened() as executor:
                    while self._todo or self._running:
                        self._step(executor)
                        yield from self._ready()
            except BrokenExecutor as error:
                idle = 0 if self._running else idle + 1
                if idle == MOST_IDLE:
                    words = "the worker processes end before they have anything to do; use --jobs 1"
                    raise UsageError(words) from error
                self._suspect()
                yield from self._ready()

    def _ready(self) -> Iterator[Answer]:
        while self._yielded in self._answers:
            yield self._answers.pop(self._yielded)
            self._yielded += 1

    def _step(self, executor: TaskExecutor) -> None:
        """Hand out one log, or wait for an answer if the workers have enough to do."""
        alone = self._suspects.intersection((*self._running.values(), *list(self._todo)[:1]))
        if not self._todo or len(self._running) >= (1 if alone else executor.in_flight):
            return self._collect(executor)
        number = self._todo[0]
        if not self._is_answered(number):
            future = executor.pool.submit(judge_file, str(self._logs[number].path.absolute()), self._question)
            self._running[future] = number
            self._copies.setdefault(self._digest(number), [])
        self._todo.popleft()
        return None

    def _is_answered(self, number: int) -> bool:
        """Whether a log needs no judging of its own: its answer is known, or that of its content is on the way."""
        log, digest = self._logs[number], self._digest(number)
        if number in self._suspects:
            return False
        known = refused(log.trouble) if log.trouble else self._known.get(digest) if digest else None
        if known is None and digest and self._cache is not None:
            known = self._cache.get(self._marks[number], digest)
        if known is not None:
            self._answers[number] = Answer(log.path, known, fresh=bool(log.trouble))
        elif digest and digest in self._copies:
            self._copies[digest].append(number)
        else:
            return False
        return True

    def _collect(self, executor: TaskExecutor) -> None:
        done, _ = wait(self._running, timeout=QUIET_S, return_when=FIRST_COMPLETED)
        if not done and not executor.manned() and not self._deserted:
            self._deserted = True
            self._warn("no worker is left; waiting for another one (Ctrl-C stops, what is finished is kept)")
        broken = {one for one in done if not one.cancelled() and isinstance(one.exception(), BrokenExecutor)}
        for future in done - broken:
            number = self._running.pop(future)
            self._settle(number, self._record(number, future, executor.killed))
        if broken:
            raise BrokenExecutor

    def _record(self, number: int, future: Future[Record], killed: tuple[type[Exception], ...]) -> Record:
        if future.cancelled():
            raise LinkError("the scheduler went away or gave up the work; start it, and scan again to go on")
        error = future.exception()
        if error is None:
            return future.result()
        if isinstance(error, InputError):
            reason = str(error).removeprefix(f"{self._logs[number].path.absolute()}: ")
        elif isinstance(error, MavdiagError):
            raise error
        elif isinstance(error, (MemoryError, *killed)):
            reason = DIED
        else:
            reason = f"a fault of mavdiag or of a worker, please report it: {type(error).__name__}: {error}"
        return refused(" ".join(reason.split()))

    def _suspect(self) -> None:
        """A worker died: who was alone has ended it; of several each is judged alone."""
        numbers = list(self._running.values())
        self._running.clear()
        if len(numbers) == 1:
            return self._settle(numbers[0], refused(DIED))
        self._suspects.update(numbers)
        return self._todo.extendleft(reversed(numbers))

    def _settle(self, number: int, record: Record) -> None:
        """A log has its answer, and all that have the same content with it. An error is not kept beyond this scan."""
        digest = self._digest(number)
        if record.digest and self._cache is not None:
            try:
                self._cache.put(self._marks[number], record)
            except UsageError as error:
                self._cache = None
                self._warn(f"answers are not kept any more: {error}")
        if digest and record.digest in ("", digest) and (self._cache is None or not record.digest):
            self._known[digest] = record
        self._suspects.discard(number)
        self._answers[number] = Answer(self._logs[number].path, record, fresh=True)
        for copy in self._copies.pop(digest, []):
            if record.digest in ("", digest):
                self._answers[copy] = Answer(self._logs[copy].path, record, fresh=False)
            else:  # the file was changed before it was judged; the others were perhaps not
                self._todo.append(copy)
