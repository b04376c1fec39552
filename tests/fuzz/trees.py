"""Folders in memory, and how they come to the disk.

A Tree has the content of each file by its name ("train/r_0.png"); in place of a file there may be something else
(SPECIAL), named by a string. ARCHIVE stands for a whole tree as one .zip.
"""

import io
import os
import stat
import zipfile
from pathlib import Path

Tree = dict[str, bytes | str]
ARCHIVE = "@zip"
_LINKS = {
    "dangling link": "nowhere/at/all", "link to /dev/zero": "/dev/zero", "link to /dev/null": "/dev/null", "link to ..": "..",
    "link to a file": "/etc/passwd",
}  # fmt: skip
SPECIAL = ("folder", "fifo", "loop", *_LINKS)


def read_tree(folder: Path) -> Tree:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def write_tree(tree: Tree, folder: Path) -> None:
    """Writes it into `folder`, which is made. Names that the system refuses are left out."""
    folder.mkdir(parents=True)
    for name, content in tree.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, bytes):
                path.write_bytes(content)
            elif content == "folder":
                path.mkdir()
            elif content == "fifo":
                os.mkfifo(path)
            else:
                path.symlink_to(path.name if content == "loop" else _LINKS[content])
        except (OSError, ValueError):  # a name below what is no folder any more
            continue


def zipped(tree: Tree) -> bytes:
    """One .zip of it, the same bytes each time; links and pipes as Unix zip stores them."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in tree.items():
            entry = zipfile.ZipInfo(name + "/" * (content == "folder"))
            entry.compress_type = zipfile.ZIP_DEFLATED if name.endswith(".json") else zipfile.ZIP_STORED
            if isinstance(content, str) and content != "folder":
                kind = stat.S_IFIFO if content == "fifo" else stat.S_IFLNK
                entry.create_system, entry.external_attr = 3, (kind | 0o644) << 16
            archive.writestr(entry, content if isinstance(content, bytes) else _LINKS.get(content, ""))
    return file.getvalue()
