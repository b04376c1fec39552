"""The way from a path to a scene that is shown: read beside the window, seen while it arrives, or told why not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from scenepack.pack import Pack
from viewer.app.forward_facing import rig_for
from viewer.app.host import Host
from viewer.app.loading import Loading
from viewer.app.rig import CameraRig
from viewer.app.state import name_of

SHOWN_NOTES = 4
Then = Callable[[], None]


class OpeningHost(Host, Protocol):
    """What can be done with a pack that was read."""

    def show(self, pack: Pack, path: Path, name: str | None = None, *, whole: bool = True) -> None:
        """Shows it. whole: False where more of it is on its way."""

    def compare_with(self, pack: Pack, path: Path) -> None:
        """Compares the open scene with it."""

    def undoable(self, rig: CameraRig) -> CameraRig:
        """`rig`, with all that can be undone in its history."""
        ...

    def opened(self) -> None:
        """The whole pack is there."""

    def close(self) -> None:
        """Back to the start page."""


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
    _room_for: Loading | None = None

    def start(self, host: OpeningHost, path: Path, *, other: bool = False, then: Then | None = None) -> None:
        """Starts to read a pack; what comes of it shows itself in later ticks."""
        self.cancel(host)
        self.loading, self.other, self.then = Loading(path), other, then
        host.touch()

    def cancel(self, host: OpeningHost) -> None:
        """Gives up reading; the scene that is open stays."""
        if self.loading is not None:
            self.loading.cancel()
            host.messages.log(f"{self.loading.path}: opening was cancelled")
            self.loading = None
            self._drop_unfinished(host)
            host.touch()

    def tick(self, host: OpeningHost) -> None:
        """What the thread that reads has to say: something to see, a pack, or why not."""
        loading = self.loading
        if loading is None:
            return
        if loading.share != self._share_told:
            self._share_told = loading.share
            host.touch(1)
        try:
            if not loading.finished:
                self._make_room(host, loading)
                self._take_preview(host, loading)
                return
            host.touch()
            self.loading = None
            for note in loading.notes:
                host.messages.log(note, "warning")
            if loading.error is not None:
                raise loading.error
            if loading.pack is not None:
                self._show_whole(host, loading.pack, loading.path)
                self._tell_notes(host, loading)
            self._give_room_back(host)
        except Exception as error:  # a dialog, and the program goes on
            loading.cancel()
            self.loading = None
            self._drop_unfinished(host)
            host.messages.fail(f"{loading.path.name} cannot be opened", error)
            host.touch()

    def _tell_notes(self, host: OpeningHost, loading: Loading) -> None:
        """Shows what was mended in a pack that is not quite as it should be: once, however often it is opened."""
        notes = [note for note in dict.fromkeys(loading.notes) if (loading.path, note) not in self.told]
        self.told |= {(loading.path, note) for note in notes}
        if notes:
            more = len(notes) - SHOWN_NOTES
            shown = [note.removeprefix(f"{loading.path}: ") for note in notes[:SHOWN_NOTES]]
            rest = [f"… and {more} more. See the Log page."] if more > 0 else []
            head = f"{name_of(loading.path)} is open. Some of its files are not as expected:"
            host.messages.show_toast("\n".join([head, *shown, *rest]), "warning")

    def _make_room(self, host: OpeningHost, loading: Loading) -> None:
        if loading.begun is not None and self._room_for is not loading and not self.other and host.stage is not None:
            host.stage.make_room(loading.begun)
            self._room_for = loading

    def _take_preview(self, host: OpeningHost, loading: Loading) -> None:
        """Shows what is there of a pack that is being read, unless a good scene is open: that stays until it is whole."""
        pack = loading.preview
        if pack is None or self.other:
            return
        if host.scene is None:
            host.show(pack, loading.path, whole=False)
        elif not host.scene.whole and host.scene.pack is not pack:
            self._refine(host, pack, told=False)

    def _show_whole(self, host: OpeningHost, pack: Pack, path: Path) -> None:
        if self.other and host.scene is not None:
            host.compare_with(pack, path)
        elif host.scene is not None and not host.scene.whole:
            self._refine(host, pack)
            host.scene.whole = True
            host.scene.rig = host.scene.rig.grown(host.undoable(rig_for(pack)))
            host.opened()
        else:
            host.show(pack, path)
        if self.then is not None:
            self.then()

    @staticmethod
    def _refine(host: OpeningHost, pack: Pack, *, told: bool = True) -> None:
        if host.stage is not None and host.scene is not None:
            with host.messages.noting_warnings(told=told):
                host.stage.refine(pack)
            host.scene.pack = pack
            host.touch()

    @staticmethod
    def _give_room_back(host: OpeningHost) -> None:
        """What was not needed of it, after all."""
        if host.stage is not None:
            host.stage.make_room(None)

    @staticmethod
    def _drop_unfinished(host: OpeningHost) -> None:
        Opening._give_room_back(host)
        if host.scene is not None and not host.scene.whole:
            host.close()
