"""Opening a pack: a thread reads it, the window shows what has arrived, and failures are reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scenepack.pack import Pack
from viewer.app.forward_facing import orbit_camera_for
from viewer.app.loading import Loading
from viewer.app.state import name_of

if TYPE_CHECKING:
    from viewer.app.application import App

SHOWN_NOTES = 4
Then = Callable[[], None]


@dataclass
class Opening:
    """loading: the pack that is being read. other: it shall be compared with, not shown instead. then: called once it is
    shown. told: what was said of which pack.
    """

    loading: Loading | None = None
    other: bool = False
    then: Then | None = None
    told: set[tuple[Path, str]] = field(default_factory=set)
    _share_told: float = -1.0
    _preallocated_for: Loading | None = None

    def start(self, app: App, path: Path, *, other: bool = False, then: Then | None = None) -> None:
        """Starts reading a pack in a thread; tick() delivers the result."""
        self.cancel(app)
        self.loading, self.other, self.then = Loading(path), other, then
        app.touch()

    def cancel(self, app: App) -> None:
        """Stops reading; the open scene stays."""
        if self.loading is not None:
            self.loading.cancel()
            app.messages.log(f"{self.loading.path}: opening was cancelled")
            self.loading = None
            self._drop_unfinished(app)
            app.touch()

    def tick(self, app: App) -> None:
        """Delivers what the thread has read: a partial pack, the whole pack, or an error."""
        loading = self.loading
        if loading is None:
            return
        if loading.share != self._share_told:
            self._share_told = loading.share
            app.touch(1)
        try:
            if not loading.finished:
                self._preallocate(app, loading)
                self._take_preview(app, loading)
                return
            app.touch()
            self.loading = None
            for note in loading.notes:
                app.messages.log(note, "warning")
            if loading.error is not None:
                raise loading.error
            if loading.pack is not None:
                self._show_whole(app, loading.pack, loading.path)
                self._tell_notes(app, loading)
            self._give_up_preallocation(app)
        except Exception as error:  # a dialog, and the program goes on
            loading.cancel()
            self.loading = None
            self._drop_unfinished(app)
            app.messages.fail(f"{loading.path.name} cannot be opened", error)
            app.touch()

    def _tell_notes(self, app: App, loading: Loading) -> None:
        """Reports repairs of an untidy pack once, however often it is opened."""
        notes = [note for note in dict.fromkeys(loading.notes) if (loading.path, note) not in self.told]
        self.told |= {(loading.path, note) for note in notes}
        if notes:
            more = len(notes) - SHOWN_NOTES
            shown = [note.removeprefix(f"{loading.path}: ") for note in notes[:SHOWN_NOTES]]
            rest = [f"… and {more} more. See the Log page."] if more > 0 else []
            head = f"{name_of(loading.path)} is open. Some of its files are not as expected:"
            app.messages.show_toast("\n".join([head, *shown, *rest]), "warning")

    def _preallocate(self, app: App, loading: Loading) -> None:
        if (
            loading.begun is not None
            and self._preallocated_for is not loading
            and not self.other
            and app.canvas is not None
        ):
            app.canvas.preallocate(loading.begun)
            self._preallocated_for = loading

    def _take_preview(self, app: App, loading: Loading) -> None:
        """Shows the part that was read, unless a whole scene is open: that stays until the new one is complete."""
        pack = loading.preview
        if pack is None or self.other:
            return
        if app.scene is None:
            app.show(pack, loading.path, whole=False)
        elif not app.scene.whole and app.scene.pack is not pack:
            self._refine(app, pack, told=False)

    def _show_whole(self, app: App, pack: Pack, path: Path) -> None:
        if self.other and app.scene is not None:
            app.compare_with(pack, path)
        elif app.scene is not None and not app.scene.whole:
            self._refine(app, pack)
            app.scene.whole = True
            app.scene.rig = app.scene.rig.grown(app.undoable(orbit_camera_for(pack)))
            app.opened()
        else:
            app.show(pack, path)
        if self.then is not None:
            self.then()

    @staticmethod
    def _refine(app: App, pack: Pack, *, told: bool = True) -> None:
        if app.canvas is not None and app.scene is not None:
            with app.messages.noting_warnings(told=told):
                app.canvas.refine(pack)
            app.scene.pack = pack
            app.touch()

    @staticmethod
    def _give_up_preallocation(app: App) -> None:
        """Gives up what was preallocated and not used."""
        if app.canvas is not None:
            app.canvas.preallocate(None)

    @staticmethod
    def _drop_unfinished(app: App) -> None:
        Opening._give_up_preallocation(app)
        if app.scene is not None and not app.scene.whole:
            app.close()
