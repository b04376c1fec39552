"""Sessions: what is open, from where it is seen, what is cut off, and its marks, in a small file that brings all of it back.

The file is JSON. A pack that lies beside or below the file is named relative to it, so that both can be moved or shared together.
Marks are added to those that are kept with a pack, and take none of them away.
"""

from __future__ import annotations

import contextlib
import json
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import platformdirs

from console import UserError
from console.atomic import write_file
from console.json_text import read_json_file
from scenepack.exports.field import Corners
from scenepack.placement import NOT_MOVED, allowed
from viewer.core.annotations import (
    Annotations,
    Bookmark,
    Scale,
    annotations_from_json,
    annotations_to_json,
    bookmark_from_json,
    bookmark_to_json,
    number_from_json,
    object_from_json,
    point_from_json,
)
from viewer.core.files import SESSION_SUFFIX, FileRequest
from viewer.core.pose import FARTHEST
from viewer.core.state import OpenScene
from viewer.core.tasks import Autosave
from viewer.features.bookmarks.bookmarks import bookmark_of, pose_of
from viewer.features.comparison.comparison import How

if TYPE_CHECKING:
    from viewer.app.application import App

VERSION = 1
MOST_PACKS = 32
REST_S = 3.0  # without a change, before the last session is written
HOWS: tuple[How, ...] = get_args(How)


def default_file() -> Path:
    return platformdirs.user_data_path("snerg", appauthor=False) / f"last{SESSION_SUFFIX}"


@dataclass(frozen=True)
class Seen:
    path: Path
    camera: Bookmark  # where it is seen from; its name is the pack's
    orthographic: bool = False  # with parallel rays
    crop: Corners | None = None  # as in RenderSettings
    near: float = 0.0  # likewise
    annotations: Annotations = field(default_factory=Annotations)


@dataclass(frozen=True)
class Session:
    packs: tuple[Seen, ...]  # the one that is shown comes first, the others as Ctrl+Tab comes to them
    compare: tuple[Path, How] | None = None  # another pack, and how
    page: str = ""  # that is open; "" for none

    @property
    def title(self) -> str:
        names = [seen.camera.name for seen in self.packs]
        return ", ".join(names[:2]) + (f" and {len(names) - 2} more" if len(names) > 2 else "")


def session_of(app: App) -> Session | None:
    """What is open now; None where that is nothing that could be opened again."""

    def seen(scene: OpenScene) -> Seen:
        rig, marks = scene.rig, scene.annotations or Annotations()
        view = bookmark_of(rig, scene.name)
        return Seen(scene.path.resolve(), view, rig.orthographic, scene.crop, scene.near, marks)

    shown = app.left_now()
    if shown is None or not shown.path.exists():
        return None
    compare, path = app.comparison, app.comparison.other_path
    against = (path.resolve(), compare.how) if compare.against == "pack" and path is not None else None
    return Session(tuple(map(seen, (shown, *app.open_packs.packs))), against, app.interface.page)


# The file


def save_session(session: Session, file: Path) -> None:
    """Writes what load_session reads, with paths relative to the file's folder where they lead into it. OSError."""
    folder = file.resolve().parent
    packs = [
        {
            "path": _relative(seen.path, folder),
            "camera": {**bookmark_to_json(seen.camera), "orthographic": seen.orthographic},
            "crop": seen.crop,
            "near": seen.near,
            "marks": annotations_to_json(seen.annotations),
        }
        for seen in session.packs
    ]
    against = session.compare
    compare = None if against is None else {"path": _relative(against[0], folder), "how": against[1]}
    document = {"snerg_session": VERSION, "packs": packs, "compare": compare, "page": session.page}
    write_file(file, json.dumps(document, indent=1))


def load_session(file: Path) -> Session:
    """Reads a session. UserError, in one line, where it cannot be read or is none."""
    try:
        return _session(read_json_file(file), file.resolve().parent)
    except OSError as error:
        raise UserError("cannot be read", where=file, found=error.strerror) from error
    except ValueError as error:
        raise UserError("is not a session", where=file, expected="a file that snerg-view saved", found=error) from error


def _session(document: Any, folder: Path) -> Session:
    """A session whose relative paths begin in `folder`. ValueError, in words, for what makes no sense."""
    entries = object_from_json(document, "the file")
    version, packs = entries.get("snerg_session"), entries.get("packs")
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise ValueError("no snerg_session")
    if version > VERSION:
        raise ValueError(f"a session of a newer version ({version})")
    if not isinstance(packs, list) or not 1 <= len(packs) <= MOST_PACKS:
        raise ValueError(f"packs: expected from 1 to {MOST_PACKS}")
    page, compare = entries.get("page", ""), entries.get("compare")
    if not isinstance(page, str):
        raise ValueError("page: expected a name")
    seen = tuple(_seen(pack, folder) for pack in packs)
    if compare is not None:
        against = object_from_json(compare, "compare")
        how = against.get("how", "wipe")
        if not isinstance(how, str) or how not in HOWS:
            raise ValueError(f"compare: expected one of {', '.join(HOWS)}")
        compare = _path(against.get("path"), folder), how
    return Session(seen, compare, page[:40])


def _seen(value: Any, folder: Path) -> Seen:
    entries = object_from_json(value, "a pack")
    camera, crop = object_from_json(entries.get("camera"), "a camera"), entries.get("crop")
    if crop is not None:
        if not isinstance(crop, list) or len(crop) != 2:
            raise ValueError("crop: expected two corners")
        low, high = (point_from_json(corner, "crop") for corner in crop)
        if any(a >= b for a, b in zip(low, high, strict=True)):
            raise ValueError("crop: its corners are in the wrong order")
        crop = low, high
    near = number_from_json(entries.get("near", 0.0), 0.0, FARTHEST, "near")
    view, flat = bookmark_from_json(camera), camera.get("orthographic") is True
    marks = annotations_from_json(entries.get("marks", {}))
    return Seen(_path(entries.get("path"), folder), view, flat, crop, near, marks)


def _path(value: Any, folder: Path) -> Path:
    if not isinstance(value, str) or not value or len(value) > 4096 or not value.isprintable():
        raise ValueError("a pack's path: expected a name")
    return folder / value


def _relative(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)


# Opening one


def restore(app: App, session: Session) -> None:
    """Opens what a session names, one pack after the other, the one that is shown last. A failure is a dialog and ends it."""
    left = [*session.packs[1:], session.packs[0]]

    def open_next() -> None:
        seen = left.pop(0)
        app.open(seen.path, then=lambda: arrived(seen))

    def arrived(seen: Seen) -> None:
        _apply(app, seen)
        if left:
            open_next()
            return
        if session.page:
            app.interface.opens(session.page)
        if session.compare is not None:
            path, app.comparison.how = session.compare
            app.open(path, other=True)

    open_next()


def _apply(app: App, seen: Seen) -> None:
    rig, marks = app.open_scene.rig, joined(app.annotations.current, seen.annotations)
    app.annotations.current = replace(marks, placement=allowed(marks.placement, app.open_scene.pack))
    rig.begin_placed(marks.placement.rotation)
    rig.held, rig.fov = None, seen.camera.fov
    rig.table = replace(rig.table, up=seen.camera.up)
    rig.orthographic = seen.orthographic and not rig.bounded
    rig.go(pose_of(seen.camera, rig.table))
    rig.shown = rig.goal
    app.set(crop=None if rig.bounded else seen.crop, near=seen.near)
    app.touch()


def joined(own: Annotations, other: Annotations) -> Annotations:
    """Marks of both; scale, look and placement are `own` where those say anything."""
    scale = own.scale if own.scale != Scale() else other.scale
    measurements = tuple(each for each in other.measurements if each not in own.measurements)
    bookmarks = tuple(each for each in other.bookmarks if each not in own.bookmarks)
    look = own.look or other.look
    placement = own.placement if own.placement != NOT_MOVED else other.placement
    return Annotations(scale, own.measurements + measurements, own.bookmarks + bookmarks, look, placement)


# The one that was open last


@dataclass
class Sessions:
    last: Session | None = None  # what was open when the program ended the last time
    _autosave: Autosave[Session | None] | None = None  # of what is open now; None where it is not kept, as in scripts

    def begin(self, file: Path) -> None:
        """Keeps the last session in `file` from now on, and offers what lies there. What is broken is not offered."""
        self._autosave = Autosave(partial(_save_last, file), None, REST_S)
        try:
            session = load_session(file)
        except UserError:
            return
        self.last = session if session.packs[0].path.exists() else None

    def open_last(self, app: App) -> None:
        if self.last is not None:
            restore(app, self.last)

    def ask_where_to_save(self, app: App) -> None:
        name, path = f"{app.open_scene.name}{SESSION_SUFFIX}", app.open_scene.path
        start = path.resolve().parent if path.exists() else None
        save = partial(self.save, app)
        app.file_request = FileRequest("Save the session", "save", save, (SESSION_SUFFIX,), name, start)

    def save(self, app: App, file: Path) -> None:
        """Writes what is open now. UserError where that is nothing, OSError where it cannot."""
        session = session_of(app)
        if session is None:
            raise UserError("there is no pack to save a session of", remedy="open one, and wait until it is complete")
        save_session(session, file)
        app.messages.say(f"Saved {file}")

    def tick(self, app: App) -> None:
        """Time passes: what has not changed for a moment is written as the last session; not while packs are on their way."""
        if self._autosave is not None and app.loading is None:
            self._autosave.follow(session_of(app) or self._autosave.saved)

    def finish(self, app: App) -> None:
        """The program ends: what is open now is the last session."""
        if self._autosave is not None:
            self._autosave.finish(session_of(app) or self._autosave.saved)
        self._autosave = None


def _save_last(file: Path, session: Session | None) -> None:
    assert session is not None
    with contextlib.suppress(OSError):  # it is a convenience: nobody is asked to do something about it
        file.parent.mkdir(parents=True, exist_ok=True)
        save_session(session, file)
