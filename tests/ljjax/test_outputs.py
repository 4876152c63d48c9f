"""Artefacts appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from ljjax.errors import InputError
from ljjax.outputs import artefacts


def tree(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): p.read_text() if p.is_file() else "" for p in sorted(folder.rglob("*"))}


@pytest.mark.parametrize("out", ["new", "new/deeper", "there", "."])
def test_files_appear_at_the_end_and_replace_their_namesakes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: str):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").mkdir()
    for folder in (tmp_path, tmp_path / "there"):
        (folder / "a.txt").write_text("old")
        (folder / "kept.txt").write_text("kept")
    with artefacts(out) as folder:
        (folder / "a.txt").write_text("new")
        (folder / "b.txt").write_text("more")
        assert not Path(out, "b.txt").exists()
    assert Path(out, "a.txt").read_text() == "new" and Path(out, "b.txt").read_text() == "more"
    assert (tmp_path / "there" / "kept.txt").read_text() == "kept"
    assert not list(tmp_path.rglob(".ljjax*"))


@pytest.mark.parametrize("error", [ValueError, InputError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("out", ["new", "new/deeper", "there"])
def test_a_failure_leaves_everything_as_it_was(tmp_path: Path, out: str, error: type[BaseException]):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "a.txt").write_text("old")
    before = tree(tmp_path)
    with pytest.raises(error), artefacts(tmp_path / out) as folder:
        (folder / "a.txt").write_text("half")
        raise error("stop")
    assert tree(tmp_path) == before


REFUSED = {
    "a file": ("file", r"file: is a file; --out names a folder"),
    "under a file": ("file/deeper", r"deeper: cannot be written"),
    "a folder in a file's way": ("blocked", r"blocked.b.txt: is a folder"),
    "an input in a file's way": ("inputs", r"inputs.a.txt: is an input"),
    "a link to nowhere": ("nowhere", r"nowhere: cannot be written"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_written_is_refused_and_left(tmp_path: Path, case: str):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "blocked" / "b.txt").mkdir(parents=True)
    (tmp_path / "inputs").mkdir()
    (tmp_path / "inputs" / "a.txt").write_text("an input")
    (tmp_path / "nowhere").symlink_to(tmp_path / "nothing")
    out, why = REFUSED[case]
    before = tree(tmp_path)
    with pytest.raises(InputError, match=why), artefacts(tmp_path / out, keep=[tmp_path / "inputs/a.txt"]) as folder:
        (folder / "a.txt").write_text("new")
        (folder / "b.txt").write_text("new")
    assert tree(tmp_path) == before
