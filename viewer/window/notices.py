"""What warnings do while the window is open."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from console import Notice


@contextmanager
def notices_logged(log: Callable[[str, str], None]) -> Iterator[None]:
    """Notices go to the log panel as well while the window is open; other warnings stay as Python shows them."""
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *rest: Any, **named: Any) -> None:
            if issubclass(category, Notice):
                log(str(message), "warning")
            usual(message, category, *rest, **named)

        warnings.showwarning = show
        yield
