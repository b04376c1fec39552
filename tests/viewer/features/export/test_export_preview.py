"""The preview of an export follows the choices: the newest one is shown, older ones are given up."""

from __future__ import annotations

import threading

import pytest

from console import UserError
from scenepack import Pack
from scenepack.exports import export_preview
from scenepack.exports.scene import Export
from tests.viewer.waiting import until
from viewer.features.export.exporting import ExportPreview


def finish(preview: ExportPreview, pack: Pack, export: Export) -> None:
    until(lambda: preview.follow(pack, export) or not preview.working)


def test_the_newest_choice_is_shown_and_older_ones_are_given_up(pack: Pack, monkeypatch) -> None:
    began, go, made = [], threading.Event(), []
    real = export_preview.preview_geometry

    def slow(pack: Pack, export: Export, tell):
        began.append(export.level)
        go.wait(60)
        tell(0.1, "")
        made.append(export.level)
        return real(pack, export, tell)

    monkeypatch.setattr(export_preview, "preview_geometry", slow)
    preview = ExportPreview()
    preview.follow(pack, Export("mesh", level=0.1))
    until(lambda: began == [0.1])
    for level in (0.2, 0.3, 0.4):
        preview.follow(pack, Export("mesh", level=level))
    assert preview.working and preview.geometry is None
    go.set()
    finish(preview, pack, Export("mesh", level=0.4))
    assert began == [0.1, 0.4] and made == [0.4]
    assert preview.geometry is not None and not preview.error and preview.news() and not preview.news()


@pytest.mark.parametrize("error", [UserError("a mesh needs scikit-image", remedy="install it"), MemoryError()])
def test_what_cannot_be_previewed_says_why(pack: Pack, monkeypatch, error: Exception) -> None:
    def fails(*_: object):
        raise error

    monkeypatch.setattr(export_preview, "preview_geometry", fails)
    preview = ExportPreview()
    finish(preview, pack, Export("mesh"))
    assert ("scikit-image" in preview.error) if isinstance(error, UserError) else ("memory" in preview.error)
