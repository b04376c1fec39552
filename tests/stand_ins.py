"""What tests put in the place of something that fails."""

from collections.abc import Callable
from typing import Any


def raising(error: BaseException) -> Callable[..., Any]:
    """A function that raises it, whatever it is given."""

    def fail(*_: object, **__: object) -> None:
        raise error

    return fail
