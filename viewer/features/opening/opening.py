"""Opening packs: the prompt for a path, reading a pack in a thread, showing what has arrived, and the packs that are open.

Open packs stay in main memory; only the one that is shown is on the GPU.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import unquote, urlsplit

from console import UserError, collect_notices
from scenepack.pack import Pack
from scenepack.reader import load_pack
from training.scenes.sources import FILMS
from viewer.core.files import SESSION_SUFFIX, FileRequest, Kind, kind_of, pack_in
from viewer.core.state import OpenScene, name_of
from viewer.core.tasks import Cancelled, Task
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.rendering.camera import outline
from viewer.rendering.skip_grid import skip_grid_of

if TYPE_CHECKING:
    from viewer.app.application import App


def work_out_ahead(pack: Pack) -> None:
    """What a window asks of a pack that it shows: worked out in this thread, it need not wait for it."""
    skip_grid_of(pack)
    outline(pack)


class Loading(Task[Pack]):
    """A pack that is being read; its result raises why it cannot be."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.images = (0, 0)  # how many are decoded, and of how many
        self.preview: Pack | None = None  # what can be shown already; another object whenever there is more to see
        self.notes: list[str] = []  # what was repaired meanwhile
        super().__init__(self._read)

    def state(self) -> object:
        return self.images

    @property
    def share(self) -> float:
        """Of its images that are decoded, 0 … 1."""
        return self.images[0] / max(self.images[1], 1)

    def _read(self) -> Pack:
        try:
            with collect_notices() as self.notes:
                pack = load_pack(self.path, on_progress=self._progress, on_preview=self._more_to_see)
                work_out_ahead(pack)
        except MemoryError as error:
            what = "not enough memory to open the pack"
            raise UserError(what, where=self.path, found=str(error) or None) from error
        return pack

    def _more_to_see(self, pack: Pack) -> None:
        work_out_ahead(pack)
        self.preview = pack

    def _progress(self, done: int, total: int) -> None:
        self.images = (done, total)
        if self.cancelled:
            raise Cancelled


# --- Opening a pack ---

SHOWN_NOTES = 4


@dataclass
class Opening:
    """The pack that is being read, and what for."""

    loading: Loading | None = None
    other: bool = False  # it shall be compared with, not shown instead
    then: Callable[[], None] | None = None  # called once it is shown
    noted: set[tuple[Path, str]] = field(default_factory=set)  # which notes of which pack were shown

    def start(self, app: App, path: Path, *, other: bool = False, then: Callable[[], None] | None = None) -> None:
        self.cancel(app)
        self.loading, self.other, self.then = Loading(path), other, then
        app.touch()

    def cancel(self, app: App) -> None:
        """Stops reading; the open scene stays."""
        if self.loading is not None:
            app.messages.log(f"{self.loading.path}: opening was cancelled")
            self._give_up(app, self.loading)

    def _give_up(self, app: App, loading: Loading) -> None:
        loading.cancel()
        self.loading = None
        if app.scene is not None and not app.scene.whole:
            app.close()
        app.touch()

    def tick(self, app: App) -> None:
        """Delivers what the thread has read: a partial pack, the whole pack, or an error."""
        loading = self.loading
        if loading is None:
            return
        if loading.news():
            app.touch(1)
        try:
            if not loading.finished:
                self._take_preview(app, loading)
                return
            app.touch()
            self.loading = None
            for note in loading.notes:
                app.messages.log(note, "warning")
            self._show_whole(app, loading.result(), loading.path)
            self._tell_notes(app, loading)
        except Exception as error:  # a dialog, and the program goes on
            self._give_up(app, loading)
            app.messages.fail(f"{loading.path.name} cannot be opened", error)

    def _tell_notes(self, app: App, loading: Loading) -> None:
        """Reports repairs of an untidy pack once, however often it is opened."""
        notes = [note for note in dict.fromkeys(loading.notes) if (loading.path, note) not in self.noted]
        self.noted |= {(loading.path, note) for note in notes}
        if notes:
            more = len(notes) - SHOWN_NOTES
            shown = [note.removeprefix(f"{loading.path}: ") for note in notes[:SHOWN_NOTES]]
            rest = [f"… and {more} more. See the Log page."] if more > 0 else []
            head = f"{name_of(loading.path)} is open. Some of its files are not as expected:"
            app.messages.show_toast("\n".join([head, *shown, *rest]), "warning")

    def _take_preview(self, app: App, loading: Loading) -> None:
        """Shows the part that was read, unless a whole scene is open: that stays until the new one is complete."""
        pack = loading.preview
        if pack is None or self.other:
            return
        if app.scene is None:
            app.show(pack, loading.path, whole=False)
        elif not app.scene.whole and app.scene.pack is not pack:
            app.refine(app.scene, pack, dialog=False)

    def _show_whole(self, app: App, pack: Pack, path: Path) -> None:
        if self.other and app.scene is not None:
            app.comparison.with_pack(app, pack, path)
        elif app.scene is not None and not app.scene.whole:
            app.refine(app.scene, pack)
            app.scene.whole = True
            finer = app.undoable(orbit_camera_for(pack))
            finer.begin_placed(app.annotations.current.placement.rotation)
            app.scene.rig = app.scene.rig.grown(finer)
            app.opened()
        else:
            app.show(pack, path)
        if self.then is not None:
            self.then()


# --- Open packs that are not shown now ---

MOST_BYTES = 2 << 30  # of all that are not shown
MOST_PACKS = 7


@dataclass
class OpenPacks:
    packs: list[OpenScene] = field(default_factory=list)  # in Ctrl+Tab's order
    show_list: bool = False  # opens the pack menu in the next frame

    def keep(self, app: App, scene: OpenScene, *, first: bool = False) -> None:
        """Adds a pack (first: at the head of the order). Closes others if there are too many, but none with unsaved erasures."""
        self.drop(scene.path)
        self.packs.insert(0 if first else len(self.packs), scene)
        others = [each for each in self.packs if not each.unsaved]
        while others and (len(self.packs) > MOST_PACKS or sum(bytes_of(each.pack) for each in self.packs) > MOST_BYTES):
            oldest = others.pop(-1 if first else 0)
            self.packs.remove(oldest)
            app.messages.log(f"{oldest.name} was closed: too many packs are open")

    def switch(self, app: App, step: int) -> None:
        """Shows the next open pack (step 1), or the one before (-1)."""
        if self.packs:
            self.switch_to(app, self.packs[0 if step > 0 else -1], backwards=step < 0)
        else:
            app.messages.say("No other pack is open")

    def switch_to(self, app: App, scene: OpenScene, *, backwards: bool = False) -> None:
        """Shows an open pack. backwards: the pack shown before becomes the first in the order, not the last."""
        if app.filming.export is not None:
            app.messages.say("An export is running: wait for it, or cancel it", "warning")
            return
        app.opening.cancel(app)
        if scene not in self.packs:  # what was still being read is closed, and this one has come back
            return
        left = app.left_now()
        app.turn_to(scene)
        self.packs.remove(scene)
        if left is not None:
            self.keep(app, left, first=backwards)

    def drop(self, path: Path) -> None:
        """Removes the pack of `path`, if there is one, because it is opened again."""
        self.packs = [scene for scene in self.packs if scene.path.resolve() != path.resolve()]


def bytes_of(pack: Pack) -> int:
    return pack.atlas_indices.nbytes + sum(atlas.nbytes for atlas in pack.atlases)


# --- The prompt ---

SHOWN = 8  # suggestions
MOST_ENTRIES = 5000  # of a folder that are looked at
OPENABLE = (".zip", SESSION_SUFFIX, *FILMS)


def path_in(text: str) -> Path | None:
    """The existing path that a text names, as file managers and shells copy paths; None for any other text."""
    text = text.strip().splitlines()[0].strip() if text.strip() else ""
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"":
        text = text[1:-1]
    if text.startswith("file://"):
        text = unquote(urlsplit(text).path)
    if not looks_like_path(text):
        return None
    path = expanded(text)
    return path if os.path.exists(path) else None


def expanded(text: str) -> Path:
    """The path with ~ replaced by the home folder; unchanged if there is no such user, as in ~0."""
    try:
        return Path(text).expanduser()
    except RuntimeError:
        return Path(text)


def looks_like_path(text: str) -> bool:
    """Whether a text can only be meant as a path."""
    text = text.strip().strip("'\"")
    return text.startswith(("/", "~", "./", "../", "file://")) or Path(text).is_absolute()


@dataclass
class OpenPrompt:
    """The line that a path is typed into, and what it suggests."""

    recent: Sequence[Path]  # packs that were opened lately
    other: bool = False  # whether it asks for a pack to compare with
    text: str = ""  # as typed
    picked: int | None = None  # index of the suggestion that Enter opens; None: the typed path
    problem: str = ""  # why the typed path cannot be opened
    lines: list[Path] = field(init=False)  # suggestions below the text
    _kinds: dict[Path, Kind] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.lines = suggestions(self.text, self.recent)

    def kind(self, path: Path) -> Kind:
        if path not in self._kinds:
            try:
                self._kinds[path] = kind_of(path)
            except OSError:
                self._kinds[path] = "unknown"
        return self._kinds[path]

    def type(self, text: str) -> None:
        if text != self.text:
            self.text, self.picked, self.problem = text, None, ""
            self.lines = suggestions(text, self.recent)

    def step(self, by: int) -> None:
        """Moves the selection; up from the first suggestion returns to the text."""
        at = (-1 if self.picked is None else self.picked) + by
        self.picked = None if at < 0 else min(at, len(self.lines) - 1) if self.lines else None

    def take(self, line: int | None = None) -> Path | None:
        """The path to open: the suggestion given, that picked, or what is typed. None where the prompt stays open."""
        picked = self.picked if line is None else line
        if picked is None and (named := path_in(self.text)) is not None:
            return named
        if picked is None and looks_like_path(self.text):
            self.problem = f"There is nothing at {self.text.strip()}."
            return None
        if picked is None and not (self.text.strip() and self.lines):
            self.problem = "Type a path, or choose one."
            return None
        path = self.lines[picked or 0]
        if path.is_dir() and self.kind(path) == "unknown":
            self.type(str(path) + os.sep)
            return None
        return path


def suggestions(text: str, recent: Sequence[Path]) -> list[Path]:
    """At most SHOWN paths: openable entries of the folder that is typed, else recent paths that hold every word of the text."""
    if looks_like_path(text):
        return _entries(text.strip())
    words = text.lower().split()
    return [path for path in recent if all(word in str(path).lower() for word in words)][:SHOWN]


def _entries(text: str) -> list[Path]:
    typed = expanded(text)
    folder, stem = (typed, "") if text.endswith((os.sep, "/")) or text == "~" else (typed.parent, typed.name.lower())
    found: list[tuple[bool, str, str]] = []  # folders come first
    try:
        with os.scandir(folder) as entries:
            for entry in islice(entries, MOST_ENTRIES):
                name = entry.name.lower()
                shown = name.startswith(stem) and (stem.startswith(".") or not name.startswith("."))
                if shown and (entry.is_dir() or name.endswith(OPENABLE)):
                    found.append((not entry.is_dir(), name, entry.name))
    except (OSError, ValueError):
        return []
    return [folder / name for _, _, name in sorted(found)[:SHOWN]]


def ask_to_open(app: App, *, other: bool = False) -> None:
    """Asks what to open. other: for a pack to compare with."""
    app.open_prompt = OpenPrompt(app.preferences.recent_packs(), other)


def choose(app: App, line: int | None = None) -> None:
    """Takes what is chosen in that question: the line given, or what Enter takes."""
    assert app.open_prompt is not None
    path, other = app.open_prompt.take(line), app.open_prompt.other
    if path is not None:
        app.open_prompt = None
        _open(app, path, other)
    app.touch()


def browse(app: App, kind: Literal["open", "folder"], *, other: bool = False) -> None:
    """Replaces the prompt by a file dialog, for a file or for a folder."""
    app.open_prompt = None
    title = "Compare with a pack" if other else "Open a pack, photographs, a film or a training run"
    suffixes = () if kind == "folder" else (".zip",) if other else OPENABLE
    app.file_request = FileRequest(title, kind, lambda path: _open(app, path, other), suffixes)


def _open(app: App, path: Path, other: bool) -> None:
    app.open(pack_in(path), other=True) if other else app.drop([path])
