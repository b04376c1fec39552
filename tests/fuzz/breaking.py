"""Not a kind of file: code that breaks, by which tests know that the fuzzer sees it."""

from pathlib import Path

from console import UserError

BASES = ("code",)
FILE = "code.py"


def write_base(name: str, folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / FILE).write_text("\n")


def open_it(path: Path, base: str) -> None:
    exec((path / FILE).read_text(), {"UserError": UserError, "path": path})
