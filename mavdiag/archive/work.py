"""What a worker process does with a log (edge: it reads files)."""

import hashlib
import os
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from mavdiag.archive.job import Question, Record
from mavdiag.archive.sources import judging_version
from mavdiag.archive.windows import windows_of
from mavdiag.baseline import parse
from mavdiag.errors import InputError, LinkError
from mavdiag.judging import judge, judge_in_full
from mavdiag.logs.csv_columns import parse_column_map
from mavdiag.logs.part import read_part
from mavdiag.storage import open_regular

__all__ = ["answer_of", "digest_of_file", "judge_file", "mark_of"]

END_BYTES = 4096  # of each end of a file: two flights differ there by their times (our choice)
CHUNK_BYTES = 1 << 20
MOST_BYTES = 1 << 40  # the readers know how long a log of their kind may be
_parsed = lru_cache(maxsize=2)(parse)  # a worker gets the same baseline with every task


def mark_of(path: Path) -> str:
    """A digest of a file's size and ends, which files of equal content share; empty if it cannot be read."""
    try:
        with open_regular(path, MOST_BYTES) as file:
            size = os.fstat(file.fileno()).st_size
            ends = file.read(END_BYTES)
            file.seek(max(len(ends), size - END_BYTES))
            ends += file.read(END_BYTES)
    except (InputError, OSError):
        return ""
    return hashlib.sha256(b"%d %s" % (size, ends)).hexdigest()[:16]


def digest_of_file(path: str) -> str:
    """SHA-256 of a log's content, hexadecimal. Raises InputError if it cannot be read."""
    digest = hashlib.sha256()
    try:
        with open_regular(Path(path), MOST_BYTES) as file:
            while part := file.read(CHUNK_BYTES):
                digest.update(part)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the path") from error
    return digest.hexdigest()


def judge_file(path: str, question: Question) -> Record:
    """Read a log and judge it.

    Raises InputError if it cannot be read, and LinkError if this process has other code, or computes with other
    packages, than the one that asks.
    """
    if judging_version() != question.version:
        raise LinkError("a worker has another version of mavdiag, numpy or scipy; install the same ones everywhere")
    options, baseline = question.options, _parsed(question.baseline)
    columns = None if options.columns is None else parse_column_map(options.columns)
    log = read_part(Path(path), options.vehicle, options.from_s, options.to_s, columns)
    if options.windows_s is None:
        return Record(log.sha256, replace(judge(log, baseline, options.judged_share), log=""))
    flight = judge_in_full(log, baseline, options.judged_share)
    return Record(
        log.sha256, replace(flight.verdict, log=""), windows_of(flight, options.windows_s, options.judged_share)
    )


def answer_of(path: str, question: Question | None) -> str | Record:
    """One task: the digest of a file, or the answer to a question about it. Raises as the two above."""
    return digest_of_file(path) if question is None else judge_file(path, question)
