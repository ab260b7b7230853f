"""What a list of files, folders and patterns names."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from made_archive import content

from mavdiag.archive.paths import logs_named
from mavdiag.errors import InputError

LOG = content(1, 200)


def tree(folder: Path, *names: str) -> Path:
    """Logs below a folder; a name that ends in .txt is none."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"notes" if name.endswith(".txt") else LOG)
    return folder


def below(folder: Path, *arguments: str) -> list[str]:
    return [str(one.path.relative_to(folder)) for one in logs_named([folder / a for a in arguments]).logs]


def test_a_folder_is_all_logs_below_it_by_name_and_what_is_no_log_is_counted(tmp_path: Path) -> None:
    tree(tmp_path, "b/2.tlog", "b/1.dat", "a.tlog", "z/y/x.tlog", "notes.txt", "b/notes.txt", ".git/a.tlog", ".b.tlog")
    (tmp_path / "empty.tlog").touch()
    found = logs_named([tmp_path])
    assert below(tmp_path, ".") == ["a.tlog", "b/1.dat", "b/2.tlog", "z/y/x.tlog"]
    assert found.skipped == 3


def test_a_pattern_is_what_it_matches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tree(tmp_path, "a/1.tlog", "a/2.tlog", "b/3.tlog", "b/notes.txt", "c[1].tlog")
    assert below(tmp_path, "*/*.tlog") == ["a/1.tlog", "a/2.tlog", "b/3.tlog"]
    assert below(tmp_path, "**/[23]*") == ["a/2.tlog", "b/3.tlog"]
    assert below(tmp_path, "[ab]") == ["a/1.tlog", "a/2.tlog", "b/3.tlog"]
    assert logs_named([tmp_path / "b" / "*"]).skipped == 1
    assert below(tmp_path, "c[1].tlog") == ["c[1].tlog"]
    monkeypatch.chdir(tmp_path)
    assert [str(one.path) for one in logs_named(["*/1*"]).logs] == ["a/1.tlog"]


@pytest.mark.parametrize("argument", ["nothing", "*.ulg", "nothing/*"])
def test_what_names_no_log_is_trouble_and_an_error_where_all_are_needed(tmp_path: Path, argument: str) -> None:
    (tmp_path / "nothing").mkdir()
    (one,) = logs_named([tmp_path / argument]).logs
    assert one.trouble.startswith("no log there; name files, a folder, or a pattern")
    with pytest.raises(InputError, match="no log there"):
        logs_named([tmp_path / argument]).paths()


def test_a_folder_that_cannot_be_read_is_trouble_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tree(tmp_path, "a/1.tlog", "b/2.tlog", "c/3.tlog")
    inside = Path.iterdir

    def refusing(self: Path) -> Iterator[Path]:
        if self.name == "b":
            raise PermissionError(13, "Permission denied")
        return inside(self)

    monkeypatch.setattr(Path, "iterdir", refusing)
    found = logs_named([tmp_path])
    assert [one.path.name for one in found.logs] == ["1.tlog", "b", "3.tlog"]
    assert found.logs[1].trouble == "the folder cannot be read (Permission denied)"
    with pytest.raises(InputError, match="b: the folder cannot be read"):
        found.paths()
