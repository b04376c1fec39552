"""The viewer in a desktop's menus: files where they belong, that can be read, and that go away again."""

import configparser
import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.viewer.waiting import not_none
from viewer.commands.view import main
from viewer.desktop import desktop_entry


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path / "data"


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("snerg.*") if path.is_file()}


def test_registering_twice_is_registering_once_and_nothing_is_left_behind_or_taken_from_others(data, capsys):
    other = data / "applications" / "other.desktop"
    other.parent.mkdir(parents=True)
    other.write_text("[Desktop Entry]\n")
    assert main(["--register"]) == 0
    first = files(data)
    assert set(first) == {
        "applications/snerg.desktop",
        "icons/hicolor/scalable/apps/snerg.svg",
        "mime/packages/snerg.xml",
    }
    assert main(["--register"]) == 0 and files(data) == first
    assert len(capsys.readouterr().out.splitlines()) == 6
    assert main(["--unregister"]) == 0 and not files(data)
    assert main(["--unregister"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "snerg-view: nothing was registered"
    assert other.read_text() == "[Desktop Entry]\n"


def test_the_entry_is_one_and_its_command_survives_odd_paths(data):
    desktop_entry.register(['/home/a b/$x\\"`%/snerg-view'])
    entry = configparser.RawConfigParser()
    entry.optionxform = str  # type: ignore[assignment]  (keys have capitals)
    entry.read(data / desktop_entry.ENTRY)
    section = dict(entry["Desktop Entry"])
    assert section["Type"] == "Application" and section["StartupWMClass"] == "snerg" and section["Icon"] == "snerg"
    assert desktop_entry.PACK_TYPE in section["MimeType"].split(";") and section["MimeType"].endswith(";")
    command = section["Exec"]
    assert command.endswith('" %f') and command.startswith('"')
    once = command[1:-4].replace("\\\\", "\\")  # the file's own escapes
    assert re.sub(r"\\(.)", r"\1", once.replace("%%", "%")) == '/home/a b/$x\\"`%/snerg-view'
    validator = shutil.which("desktop-file-validate")
    if validator:
        done = subprocess.run([validator, str(data / desktop_entry.ENTRY)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout


def test_icon_and_types_are_xml_and_packs_are_told_by_their_first_bytes(data, demo):
    desktop_entry.register(["snerg-view"])
    icon = ElementTree.parse(data / desktop_entry.ICON).getroot()
    assert icon.tag.endswith("svg") and len(icon) == 7
    types = ElementTree.parse(data / desktop_entry.TYPES).getroot()
    name = "{http://www.freedesktop.org/standards/shared-mime-info}"
    outer = not_none(types.find(f"{name}mime-type/{name}magic/{name}match"))
    inner = not_none(outer.find(f"{name}match")).attrib
    head = demo.read_bytes()[:64]
    assert head[:4] == b"PK\x03\x04" and outer.get("value") == "PK\\003\\004"
    assert head[int(inner["offset"]) :].startswith(inner["value"].encode())
    with zipfile.ZipFile(demo) as archive:
        assert archive.namelist()[0] == "scene_params.json"
    if shutil.which("update-mime-database"):
        assert (data / "mime" / "magic").read_bytes().count(b"application/x-snerg-pack") == 1


def test_a_folder_that_cannot_be_written_is_one_line_and_status_2(data, refused):
    data.write_text("a file")
    refused(main, "--register")


def test_the_command_starts_this_viewer():
    command = desktop_entry.own_command()
    assert os.access(command[0], os.X_OK)
    done = subprocess.run([*command, "--frames", "0"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and "--frames" in done.stderr
