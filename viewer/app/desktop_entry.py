"""The viewer in a Linux desktop's menus: a .desktop file, an icon, and what file managers know of packs.

Sources: freedesktop.org's Desktop Entry, Icon Theme and Shared MIME-info specifications. All files lie in the user's data folder
($XDG_DATA_HOME, by default ~/.local/share); nothing outside of it is touched.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from console import UserError, not_written
from console.atomic import write_file
from console.python_command import module_command
from training.scenes.sources import CONTAINERS

NAME = "snerg"  # also the window's class, by which a desktop knows whose window it is
PACK_TYPE = "application/x-snerg-pack"
ENTRY, ICON, TYPES = (
    Path("applications", f"{NAME}.desktop"),
    Path("icons", "hicolor", "scalable", "apps", f"{NAME}.svg"),
    Path("mime", "packages", f"{NAME}.xml"),
)
FILMS = ";".join(kind for container in CONTAINERS for kind in container.mime_types)
REFRESH = (("update-desktop-database", "applications"), ("update-mime-database", "mime"))

DESKTOP = """[Desktop Entry]
Type=Application
Version=1.1
Name=snerg
GenericName=Radiance Field Viewer
Comment=Fly through scenes made from photographs
Exec={command} %f
Icon=snerg
Terminal=false
Categories=Graphics;3DGraphics;Viewer;
Keywords=NeRF;SNeRG;photogrammetry;3D;
MimeType={types};
StartupWMClass=snerg
StartupNotify=true
"""
# A pack's first entry is its parameters, whose name stands at byte 30 of a .zip.
MIME = f"""<?xml version="1.0" encoding="UTF-8"?>
<mime-info xmlns="http://www.freedesktop.org/standards/shared-mime-info">
  <mime-type type="{PACK_TYPE}">
    <comment>snerg scene</comment>
    <sub-class-of type="application/zip"/>
    <icon name="{NAME}"/>
    <magic priority="70">
      <match type="string" offset="0" value="PK\\003\\004">
        <match type="string" offset="30" value="scene_params.json"/>
      </match>
    </magic>
    <glob pattern="*.snerg.zip" weight="60"/>
  </mime-type>
</mime-info>
"""
VOXELS = ((0, 0, 1.0), (1, 0, 0.45), (2, 0, 0.7), (0, 1, 0.25), (1, 1, 0.7), (2, 1, 0.35))  # as on the start page


def data_folder() -> Path:
    """Where the user's own files for desktops lie."""
    given = os.environ.get("XDG_DATA_HOME", "")
    return Path(given) if os.path.isabs(given) else Path.home() / ".local" / "share"


def register(command: list[str]) -> list[Path]:
    """Writes the three files, or writes them anew; where they are. command: what starts the viewer.

    UserError where they cannot be written, or where the system has no such desktops.
    """
    _check_system("--register")
    folder = data_folder()
    entry = DESKTOP.format(
        command=" ".join(map(_quoted, command)), types=";".join([PACK_TYPE, "inode/directory", FILMS])
    )
    for path, text in ((ENTRY, entry), (ICON, _svg()), (TYPES, MIME)):
        try:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_file(folder / path, text)
        except OSError as error:
            words, remedy = not_written(error)
            raise UserError(f"cannot be written: {words}", where=folder / path, remedy=remedy) from error
    _refresh(folder)
    return [folder / path for path in (ENTRY, ICON, TYPES)]


def unregister() -> list[Path]:
    """Removes them; those that were there. UserError as of register()."""
    _check_system("--unregister")
    folder, gone = data_folder(), []
    for path in (ENTRY, ICON, TYPES):
        try:
            (folder / path).unlink()
            gone.append(folder / path)
        except FileNotFoundError:
            continue
        except OSError as error:
            raise UserError(f"cannot be removed: {error.strerror}", where=folder / path) from error
    if gone:
        _refresh(folder)
    return gone


def own_command() -> list[str]:
    """What starts this viewer again, from anywhere."""
    script = Path(sys.executable).with_name("snerg-view")
    if script.is_file():
        return [str(script)]
    return module_command("viewer.commands.view")


def _check_system(option: str) -> None:
    if sys.platform in ("win32", "darwin"):
        raise UserError("is for Linux desktops", where=option, found=sys.platform)


def _quoted(word: str) -> str:
    """A word of an Exec line. The file's own escapes come on top of those within quotes."""
    escaped = "".join(f"\\{letter}" if letter in '"`$\\' else letter for letter in word)
    return '"' + escaped.replace("\\", "\\\\").replace("%", "%%") + '"'


def _svg() -> str:
    """The program's mark: voxels, one of them fully lit, on a dark tile."""
    cells = "".join(
        f'<rect x="{22 + 30 * x}" y="{37 + 30 * y}" width="24" height="24" rx="6" fill="#45d0bd" fill-opacity="{alpha}"/>'
        for x, y, alpha in VOXELS
    )
    tile = '<rect x="4" y="4" width="120" height="120" rx="26" fill="#131922"/>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="128" height="128" viewBox="0 0 128 128">{tile}{cells}</svg>\n'
    )


def _refresh(folder: Path) -> None:
    """Has the desktop read its folders anew, where it has programs for that; others notice by themselves."""
    for program, below in REFRESH:
        found = shutil.which(program)
        if found and (folder / below).is_dir():
            subprocess.run([found, str(folder / below)], capture_output=True, timeout=60, check=False)
