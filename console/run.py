"""The frame around every command: arguments in, exit status out (docs/commands.md)."""

import contextlib
import functools
import inspect
import io
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from typing import Any

import tyro

from console.errors import UserError, missing_extra, plain_notices, refusal
from console.progress_protocol import Reporter, ending_with_stdin
from console.streams import lasting_output, one_line

DONE, BUG, USER_CAN_MEND, INTERRUPTED = 0, 1, 2, 130

Command = Callable[..., Any]
_FLAGS = (tyro.conf.FlagCreatePairsOff,)  # --resume, and no --no-resume beside it
_HELP = {"-h", "--help"}


def run_command(
    command: Command | Mapping[str, Command],
    *,
    prog: str,
    description: str | None = None,
    args: Sequence[str] | None = None,
    on_failure: Callable[[str, str], None] | None = None,
) -> int:
    """Parses `args` (default: sys.argv) into a call of `command`; what that raises becomes an exit status.

    command: a function whose parameters become options (`max_steps` is --max-steps, a bool is a flag, a positional-only
    parameter is an argument; the docstring's Args give the help), or a dataclass with such fields and a method run(), or
    several functions by name, which become subcommands. A whole number that it returns is the exit status. on_failure:
    called with `prog` and the line of a failure, status 1 or 2, after it was printed.
    Returns 0 done, 2 the user can correct it (one line on stderr), 1 a bug (with its traceback), 130
    interrupted. `--debug` anywhere on the command line shows tracebacks for status 2 as well.
    """
    words = list(sys.argv[1:] if args is None else args)
    debug = "--debug" in words
    words = _with_joined_values([word for word in words if word != "--debug"])
    with lasting_output():
        try:
            with plain_notices(prog), ending_with_stdin():
                call = _parse(command, prog, description, words)
                if not callable(call):
                    return call
                result = call()
                if is_dataclass(result) and callable(run := getattr(result, "run", None)):
                    result = run()
                sys.stdout.flush()  # here, where a full disk is still caught
            return result if isinstance(result, int) and not isinstance(result, bool) else DONE
        except KeyboardInterrupt as interrupt:
            _say(prog, f"interrupted{'; ' + str(interrupt) if str(interrupt) else ''}")
            return INTERRUPTED
        except Exception as error:
            # None for a bug
            line = str(error) if isinstance(error, UserError) else refusal(error) or missing_extra(error)
            Reporter().tell_failure(prog, line or traceback.format_exception_only(error)[-1].strip(), bug=line is None)
            if line is None or debug:
                traceback.print_exc()
            _say(prog, line or "this is a bug in snerg; please report the lines above")
            if on_failure is not None:
                on_failure(prog, line or f"This is a bug in snerg: {type(error).__name__}: {error}")
            return BUG if line is None else USER_CAN_MEND


def _with_joined_values(words: Sequence[str]) -> list[str]:
    """`--eye -1,2,3` as `--eye=-1,2,3`: otherwise the value would be taken for an option."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1].startswith("--") and re.match(r"-[\d.]", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _say(prog: str, line: str) -> None:
    print(f"{prog}: {one_line(line)}", file=sys.stderr, flush=True)


def _parse(
    command: Command | Mapping[str, Command], prog: str, description: str | None, words: Sequence[str]
) -> Callable[[], Any] | int:
    """The call that `words` ask for, not yet made; or the exit status where there is nothing to call.

    tyro makes the call itself, and draws a box around complaints about arguments. So it is handed functions
    that only remember their arguments, and its box becomes one line.
    """
    how: Any = {"prog": prog, "description": description, "args": words, "config": _FLAGS}
    box = io.StringIO()
    # Help is for the screen as it is; a complaint is read by us, so no line of it should be broken in two.
    screen = contextlib.nullcontext() if _HELP & set(words) else _wide_screen()
    try:
        with screen, contextlib.redirect_stderr(box):
            if isinstance(command, Mapping):
                functions = {name: _deferred(function) for name, function in command.items()}
                return tyro.extras.subcommand_cli_from_dict(functions, **how)
            return tyro.cli(_deferred(command), **how)
    except SystemExit as stop:  # --help, or arguments that do not fit
        if stop.code in (None, DONE):
            return DONE
    line = f"{unboxed(box.getvalue())}; see {prog} --help"
    Reporter().tell_failure(prog, line)
    _say(prog, line)
    return USER_CAN_MEND


@contextlib.contextmanager
def _wide_screen() -> Iterator[None]:
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "4000"
    try:
        yield
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before


def _deferred(function: Command) -> Command:
    @functools.wraps(function)
    def remember(*args: Any, **kwargs: Any) -> Callable[[], Any]:
        return functools.partial(function, *args, **kwargs)

    if function.__doc__:  # tyro reads that of the function itself
        function.__doc__ = _unwrapped(function.__doc__)
    return remember


def _unwrapped(docstring: str) -> str:
    """A docstring whose Args are one line each: tyro keeps their line breaks, wherever the terminal's are."""
    lines: list[str] = []
    for line in inspect.cleandoc(docstring).splitlines():
        if line.startswith(" " * 8) and lines:  # below a parameter's name, which is indented by four
            lines[-1] += f" {line.strip()}"
        else:
            lines.append(line)
    return "\n".join(lines)


def unboxed(text: str) -> str:
    """tyro's complaint about arguments as one line, without its frame, help texts and pointers to --help."""
    sections: list[list[str]] = [[]]
    skipping = False
    for row in text.splitlines()[1:]:  # after the title
        inner = row[1:].rstrip(" │").removeprefix(" ")  # the frame is of blanks where it cannot be drawn
        indent = len(inner) - len(inner.lstrip())
        inner = inner.strip()
        if not inner.strip("─-╰╯"):  # frame, or the rule between two sections
            sections.append([])
            skipping = False
        elif inner.startswith(("Argument helptext", "For full helptext")):
            skipping = True
        elif inner.startswith("Missing from"):
            sections[-1].append("missing:")
        elif not skipping and indent < 8:  # deeper rows are help texts
            sections[-1].append(inner + ("," if indent == 4 else ""))
    lines = [" ".join(section).rstrip(" .,") for section in sections if section]
    lines = [line[:1].lower() + line[1:] for line in lines]
    return "; ".join(lines) or "the arguments do not fit"
