"""Pictures that cannot be put on the clipboard say why. (tests/viewer/window/live_takeaway.py pastes one.)"""

from __future__ import annotations

import copykitten
import numpy as np
import pytest

from console import UserError
from viewer.features.film.filming import copy_picture


def test_without_a_clipboard_the_reason_and_the_remedy_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*_: object) -> None:
        raise copykitten.CopykittenError("there is no display")

    monkeypatch.setattr(copykitten, "copy_image", refuses)
    with pytest.raises(UserError, match=r"cannot be reached.*there is no display.*Ctrl\+S"):
        copy_picture(np.zeros((4, 6, 3), np.uint8))


def test_a_picture_that_does_not_fit_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(copykitten, "copy_image", lambda *words: pytest.fail("it was handed over"))
    noise = np.random.default_rng(0).integers(0, 256, (2400, 2400, 3), np.uint8)
    with pytest.raises(UserError, match="too large"):
        copy_picture(noise)
