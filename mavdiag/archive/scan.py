"""Each content of a list of logs judged once, by several workers, and answered for each log once (edge).

    logs ─ mark ─▶ seen? ─ yes ─ digest ─▶ known? ─ yes ─▶ answer
                     └─ no ─────────────────┴─ no ─ judge ─▶ keep ─▶ answers of all logs with this content

The mark is of a file's size and ends, so it costs nothing; a log that shares it with no other is read only once.
A log that cannot be read is answered as an error; so is one whose judging ends its worker. Nothing else is lost by it.
"""

from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass

from mavdiag.archive.cache import Cache
from mavdiag.archive.job import Answer, Question, Record, refused
from mavdiag.archive.paths import Named
from mavdiag.archive.pool import TaskExecutor
from mavdiag.archive.work import answer_of, mark_of
from mavdiag.errors import InputError, LinkError, MavdiagError, UsageError

__all__ = ["in_order", "scan"]

Opened = Callable[[], AbstractContextManager[TaskExecutor]]
QUIET_S = 15.0  # without an answer, until it is looked whether there is any worker (our choice)
MOST_IDLE = 3  # times that workers may die without work (our choice)
DIED = "the process that judged it died, perhaps for want of memory; judge it alone, or a part of it (--from, --to)"


@dataclass(frozen=True, slots=True)
class _Call:
    """What a worker does: judge a log, or find its digest. digest: empty if it is not known yet."""

    number: int
    judge: bool
    digest: str = ""


def scan(
    logs: Sequence[Named],
    question: Question,
    opened: Opened,
    cache: Cache | None = None,
    warn: Callable[[str], None] = lambda text: None,
) -> Generator[Answer, None, None]:
    """The answers, in the order in which they are found; each log has one.

    opened: opens the workers; a second time if a worker died.
    cache: answers from before, and where new ones are kept as they come.
    warn: is told once if they cannot be kept, and if no worker is left.
    Raises UsageError or LinkError if the workers cannot go on.
    """
    run = _Run(logs, question, cache, warn)
    yield from run.refused()
    idle = 0
    while run.left:
        try:
            with opened() as executor:
                yield from run.work(executor)
        except BrokenExecutor as error:
            idle = 0 if run.busy else idle + 1
            if idle == MOST_IDLE:
                raise UsageError("the worker processes end before they have anything to do; use --jobs 1") from error
            yield from run.broken()


def in_order(answers: Iterable[Answer]) -> Iterator[Answer]:
    """The same answers in the order of their numbers, each as soon as all before it are there."""
    waiting: dict[int, Answer] = {}
    following = 0
    for answer in answers:
        waiting[answer.number] = answer
        while following in waiting:
            yield waiting.pop(following)
            following += 1


class _Run:
    """One scan: what is still to be done, what is being done, and who waits for whose answer."""

    def __init__(
        self, logs: Sequence[Named], question: Question, cache: Cache | None, warn: Callable[[str], None]
    ) -> None:
        self._logs, self._question, self._cache, self._warn = logs, question, cache, warn
        self._paths = [str(one.path.absolute()) for one in logs]
        self._marks = [mark_of(one.path) for one in logs]
        doubtful = frozenset() if cache is None else cache.marks()
        doubtful |= {mark for mark, count in Counter(self._marks).items() if count > 1}
        self._todo = deque(
            _Call(number, judge=self._marks[number] not in doubtful)
            for number, one in enumerate(logs)
            if not one.trouble
        )
        self._unjudged: deque[_Call] = deque()
        self._suspected: deque[_Call] = deque()  # one of them ended a worker: they are done alone
        self._running: dict[Future[str | Record], _Call] = {}
        self._waiting: dict[str, list[int]] = {}  # logs of a content that is being judged, by its digest
        self._told = False  # that no worker is left
        self._known: dict[str, Record] = {}  # answers that are not in the cache, by digest

    @property
    def left(self) -> bool:
        """Whether anything is still to be done."""
        return bool(self._todo or self._unjudged or self._suspected or self._running)

    @property
    def busy(self) -> bool:
        """Whether a worker has something to do."""
        return bool(self._running)

    def refused(self) -> Iterator[Answer]:
        """The answers for what could not even be looked for."""
        for number, one in enumerate(self._logs):
            if one.trouble:
                yield Answer(number, one.path, refused(one.trouble), fresh=True)

    def work(self, executor: TaskExecutor) -> Iterator[Answer]:
        """Keep the workers busy until nothing is left. Raises BrokenExecutor if one of them died."""
        while self.left:
            self._submit(executor)
            done, _ = wait(self._running, timeout=QUIET_S, return_when=FIRST_COMPLETED)
            if not done and not executor.manned():
                self._say_unmanned()
            for future in done:
                if isinstance(future.exception() if not future.cancelled() else None, BrokenExecutor):
                    continue  # told of all that run, below
                yield from self._finished(self._running.pop(future), future, executor.killed)
            if any(future in self._running for future in done):
                raise BrokenExecutor

    def broken(self) -> Iterator[Answer]:
        """A worker died: who was alone has ended it, of several each is suspected."""
        calls = list(self._running.values())
        self._running.clear()
        if len(calls) > 1:
            self._suspected.extend(calls)
            return
        for call in calls:
            yield from self._settled(call, refused(DIED))

    def _submit(self, executor: TaskExecutor) -> None:
        """Hand out as much as the workers take; judging comes first, since its answers are what is waited for."""
        most = 1 if self._suspected else executor.in_flight
        while len(self._running) < most:
            queue = self._suspected or self._unjudged or self._todo
            if not queue:
                return
            call = queue[0]
            question = self._question if call.judge else None
            future = executor.pool.submit(answer_of, self._paths[call.number], question)
            queue.popleft()
            self._running[future] = call

    def _finished(
        self, call: _Call, future: Future[str | Record], killed: tuple[type[Exception], ...]
    ) -> Iterator[Answer]:
        """What follows from the end of a call. killed: errors that say that its workers died."""
        if future.cancelled():
            raise LinkError("the scheduler went away or gave up the work; start it, and scan again to go on")
        error = future.exception()
        if error is None:
            found = future.result()
            if isinstance(found, Record):
                yield from self._settled(call, found)
            else:
                yield from self._read(_Call(call.number, judge=True, digest=found))
            return
        if isinstance(error, InputError):
            reason = str(error).removeprefix(f"{self._paths[call.number]}: ")
        elif isinstance(error, MavdiagError):
            raise error
        elif isinstance(error, (MemoryError, *killed)):
            reason = DIED
        else:
            reason = f"a fault of mavdiag or of a worker, please report it: {type(error).__name__}: {error}"
        yield from self._settled(call, refused(" ".join(reason.split())))

    def _read(self, call: _Call) -> Iterator[Answer]:
        """The digest of a log is known: is the answer?"""
        digest = call.digest
        kept = None if self._cache is None else self._cache.get(self._marks[call.number], digest)
        known = self._known.get(digest) if kept is None else kept
        if known is not None:
            yield self._answer(call.number, known, fresh=False)
        elif digest in self._waiting:
            self._waiting[digest].append(call.number)
        else:
            self._waiting[digest] = []
            self._unjudged.append(call)

    def _settled(self, call: _Call, record: Record) -> Iterator[Answer]:
        """A log has its answer, and all that have the same content with it."""
        self._keep(call, record)
        yield self._answer(call.number, record, fresh=True)
        for number in self._waiting.pop(call.digest, []):
            if record.digest in ("", call.digest):
                yield self._answer(number, record, fresh=False)
            else:  # the file was changed before it was judged; the others were perhaps not
                self._todo.append(_Call(number, judge=False))

    def _answer(self, number: int, record: Record, *, fresh: bool) -> Answer:
        return Answer(number, self._logs[number].path, record, fresh)

    def _say_unmanned(self) -> None:
        if not self._told:
            self._warn("no worker is left; waiting for another one (Ctrl-C stops, what is finished is kept)")
        self._told = True

    def _keep(self, call: _Call, record: Record) -> None:
        """Keep an answer; an error is not kept beyond this scan, for the next one may do better."""
        if record.digest and self._cache is not None:
            try:
                self._cache.put(self._marks[call.number], record)
                return
            except UsageError as error:
                self._cache = None
                self._warn(f"answers are not kept any more: {error}")
        if call.digest and record.digest in ("", call.digest):
            self._known[call.digest] = record
