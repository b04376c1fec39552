"""SnergError, and the decorator that turns what the packages below raise into it."""

import re
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

# Options of commands in remedies that are arguments in Python, too.
ARGUMENTS = re.compile(r"--(codec|downscale|level|masks|out|preset|resume|seed)\b")
P = ParamSpec("P")
R = TypeVar("R")


class SnergError(Exception):
    """Something that the user can correct: arguments, files, data, a package that is not installed, or no OpenGL.

    Attributes: `what` is wrong, `where` (file, key or argument), what was `expected` there and `found` instead, and the
    `remedy`. All but `what` may be None. The message is one line that holds all of them.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str | Path | None = None,
        expected: object = None,
        found: object = None,
        remedy: str | None = None,
    ) -> None:
        """Keeps the fields, and puts them into one line."""
        from console.errors import UserError

        self.what: str = what
        self.where: str | Path | None = where
        self.expected: object = expected
        self.found: object = found
        self.remedy: str | None = remedy
        super().__init__(str(UserError(what, where=where, expected=expected, found=found, remedy=remedy)))


def with_snerg_errors(function: Callable[P, R]) -> Callable[P, R]:
    """Raises SnergError for all that the user can correct; bugs stay as they are."""

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except SnergError:
            raise
        except Exception as error:
            from console.errors import UserError, missing_extra, refusal

            if isinstance(error, UserError):
                fields = vars(error)
                if str(fields["where"]).startswith("--"):  # an option of a command, and the argument of the same name
                    fields = {**fields, "where": fields["where"].removeprefix("--").replace("-", "_")}
                if "snerg-" not in (fields["remedy"] or "snerg-"):  # a whole command stays one
                    fields = {**fields, "remedy": ARGUMENTS.sub(r"\1", fields["remedy"])}
                raise SnergError(**fields) from error
            if (line := refusal(error) or missing_extra(error)) is None:
                raise
            raise SnergError(line) from error

    return call
