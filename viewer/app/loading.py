"""Opening a pack in a thread, so that the window stays alive and the old scene stays until the new one is good."""

from __future__ import annotations

import warnings
from pathlib import Path

from console import UserError
from scenepack.pack import Pack
from scenepack.reader import load_pack
from viewer.app.background import Task
from viewer.rendering.framing import outline
from viewer.rendering.skip_grid import skip_grid_of


def work_out_ahead(pack: Pack) -> None:
    """What a window asks of a pack that it shows: worked out in this thread, it need not wait for it."""
    skip_grid_of(pack)
    outline(pack)


class Cancelled(Exception):
    """Loading was given up by the user."""


class Loading(Task[None]):
    """A pack that is being read. Once it is finished, take `pack` or `error`.

    share: 0 … 1 of its images are decoded. images: how many are, and of how many; 0 of 0 at first. preview: what can be
    shown of it already, another object whenever there is more to see; None at first. begun: the pack before its images are
    decoded, to make room for; None at first. error: a UserError or a bug's exception, None where all went well or it was
    cancelled. notes: what was mended while it was read.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.share = 0.0
        self.images = (0, 0)
        self.pack: Pack | None = None
        self.preview: Pack | None = None
        self.begun: Pack | None = None
        self.error: Exception | None = None
        self.notes: list[str] = []
        self.cancelled = False
        super().__init__(self._read)

    def cancel(self) -> None:
        """Gives up at the next image."""
        self.cancelled = True

    def _read(self) -> None:
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                pack = load_pack(
                    self.path, on_progress=self._progress, on_preview=self._more_to_see, on_begin=self._begin
                )
                work_out_ahead(pack)
            self.notes = [str(warning.message) for warning in caught]
            self.pack = None if self.cancelled else pack
        except Cancelled:
            pass
        except MemoryError as error:
            self.error = UserError("not enough memory to open the pack", where=self.path, found=str(error) or None)
        except Exception as error:  # shown in a dialog; the program goes on
            self.error = error

    def _begin(self, pack: Pack) -> None:
        self.begun = pack

    def _more_to_see(self, pack: Pack) -> None:
        work_out_ahead(pack)
        self.preview = pack

    def _progress(self, done: int, total: int) -> None:
        self.share, self.images = done / max(total, 1), (done, total)
        if self.cancelled:
            raise Cancelled
