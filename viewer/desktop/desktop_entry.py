"""Desktop entry: installs the files of this folder on a Linux desktop: menu entry, icon, and the type of packs.

Sources: freedesktop.org's Desktop Entry, Icon Theme and Shared MIME-info specifications. All files lie in the user's data folder
($XDG_DATA_HOME, by default ~/.local/share); nothing outside of it is touched.
"""

import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path

import platformdirs

from console import UserError, write_result
from console.child_process import module_command
from training.scenes.sources import CONTAINERS

NAME = "snerg"  # also the window's class, by which a desktop knows whose window it is
PACK_TYPE = "application/x-snerg-pack"
ENTRY = Path("applications", f"{NAME}.desktop")
ICON = Path("icons", "hicolor", "scalable", "apps", f"{NAME}.svg")
TYPES = Path("mime", "packages", f"{NAME}.xml")
REFRESH = (("update-desktop-database", "applications"), ("update-mime-database", "mime"))


def register(command: list[str]) -> list[Path]:
    """Writes the three files and returns them. command: what starts the viewer. UserError where they cannot be written."""
    _check_system("--register")
    folder = platformdirs.user_data_path()
    types = [PACK_TYPE, "inode/directory", *(kind for container in CONTAINERS for kind in container.mime_types)]
    values = {"{command}": " ".join(map(_quoted, command)), "{types}": ";".join(types)}
    for path in (ENTRY, ICON, TYPES):
        text = (resources.files("viewer.desktop") / path.name).read_text(encoding="utf-8")
        for name, value in values.items():
            text = text.replace(name, value)
        write_result(folder / path, text)
    _refresh(folder)
    return [folder / path for path in (ENTRY, ICON, TYPES)]


def unregister() -> list[Path]:
    """Removes them; those that were there. UserError as of register()."""
    _check_system("--unregister")
    folder = platformdirs.user_data_path()
    gone = [folder / path for path in (ENTRY, ICON, TYPES) if (folder / path).exists()]
    for path in gone:
        try:
            path.unlink()
        except OSError as error:
            raise UserError(f"cannot be removed: {error.strerror}", where=path) from error
    if gone:
        _refresh(folder)
    return gone


def own_command() -> list[str]:
    """What starts this viewer again, from anywhere."""
    script = Path(sys.executable).with_name("snerg-view")
    if script.is_file():
        return [str(script)]
    return module_command("snerg", "view")


def _check_system(option: str) -> None:
    if sys.platform in ("win32", "darwin"):
        raise UserError("is for Linux desktops", where=option, found=sys.platform)


def _quoted(word: str) -> str:
    """A word of an Exec line. The file's own escapes come on top of those within quotes."""
    escaped = "".join(f"\\{letter}" if letter in '"`$\\' else letter for letter in word)
    return '"' + escaped.replace("\\", "\\\\").replace("%", "%%") + '"'


def _refresh(folder: Path) -> None:
    """Has the desktop read its folders anew, where it has programs for that; others notice by themselves."""
    for program, below in REFRESH:
        found = shutil.which(program)
        if found and (folder / below).is_dir():
            subprocess.run([found, str(folder / below)], capture_output=True, timeout=60, check=False)
