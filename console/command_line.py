"""The command line of every command: arguments in, exit status out (docs/commands.md), and what options have in common.

Sizes, numbers and points are read from text. Files that options name are written whole: figures as JSON, tables as text. Commands
ask `check_results` before work that takes minutes, so that a place where nothing can be written is reported first.
"""

import contextlib
import errno
import functools
import inspect
import io
import json
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import tyro

from console.atomic import is_stream, reserved, try_folder, write_file
from console.errors import UserError, handle_notices, missing_extra, not_written, refusal
from console.progress_protocol import ending_with_stdin, write_failure
from console.streams import lasting_output, one_line

DONE, BUG, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

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
            with handle_notices(lambda text: _say(prog, f"warning: {text}")), ending_with_stdin():
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
            write_failure(prog, line or traceback.format_exception_only(error)[-1].strip(), bug=line is None)
            if line is None or debug:
                traceback.print_exc()
            _say(prog, line or "this is a bug in snerg; please report the lines above")
            if on_failure is not None:
                on_failure(prog, line or f"This is a bug in snerg: {type(error).__name__}: {error}")
            return BUG if line is None else BAD_INPUT


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
    line = f"{_unboxed(box.getvalue())}; see {prog} --help"
    write_failure(prog, line)
    _say(prog, line)
    return BAD_INPUT


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
    return re.sub(r"\n {8} *", " ", inspect.cleandoc(docstring))  # below a parameter's name, which is indented by four


# What tyro says of a value that none of an option's types takes: the option, its types but None, and the value.
_OF_SEVERAL_TYPES = re.compile(
    r"error parsing (\S+): no type matching (?:\{None\}\|)?(\S+) could be instantiated from \['?(.*?)'?\]; got errors.*"
)


def _unboxed(text: str) -> str:
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
    line = "; ".join(lines) or "the arguments do not fit"
    return _OF_SEVERAL_TYPES.sub(
        lambda found: str(UserError("is not understood", where=found[1], expected=found[2], found=found[3])), line
    )


# --- Values that options of several commands have ---

MAX_SIDE = 16384


def parse_size(text: str, where: str = "--size", *, least: int = 1) -> tuple[int, int]:
    """ "800x600" as (width, height), both at least `least`. UserError for anything else."""
    match = re.fullmatch(r"(\d+)[x×](\d+)", text.strip())
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(least <= side <= MAX_SIDE for side in size):
        sides = f", sides of {least} to {MAX_SIDE}" if match else ""
        raise UserError(
            "is not a size in pixels", where=where, expected=f"WxH such as 800x600{sides}", found=repr(text)
        )
    return size


def parse_numbers(text: str, count: int, where: str) -> tuple[float, ...]:
    """ "1,2,3" as `count` finite numbers. UserError for anything else."""
    try:
        numbers = tuple(float(word) for word in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(abs(number) < 1e30 for number in numbers):
        example = ",".join("123456"[:count])
        raise UserError(
            "is not a list of numbers", where=where, expected=f"{count} such as {example}", found=repr(text)
        )
    return numbers


def parse_point(text: str, where: str) -> tuple[float, float, float]:
    """ "x,y,z" as three finite numbers. UserError for anything else."""
    x, y, z = parse_numbers(text, 3, where)
    return x, y, z


def parse_crop(text: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """ "x0,y0,z0,x1,y1,z1", as --crop has it, as two corners. UserError for anything else."""
    x0, y0, z0, x1, y1, z1 = parse_numbers(text, 6, "--crop")
    return (x0, y0, z0), (x1, y1, z1)


def require_in_range(where: str, value: float | None, low: float, high: float) -> None:
    """UserError where the value of an option, None where it is left out, is not one of low … high."""
    if value is not None and not low <= value <= high:
        ends = (str(end) if isinstance(end, int) else f"{end:g}" for end in (low, high))
        raise UserError("is out of range", where=where, expected=" to ".join(ends), found=value)


# --- Files that options name ---

STDOUT = Path("-")


def check_results(*files: Path | None, folder: Path | None = None) -> None:
    """UserError where one of `files` could not be written, or no file in `folder`. Tries it, and leaves nothing behind.

    None stands for what is not asked for, "-" for stdout. Folders that are missing are not made.
    """
    for file in files:
        if file is not None and file != STDOUT:
            with writing_to(file):
                _try_file(file)
    if folder is not None:
        with writing_to(folder):
            try_folder(folder)


def write_json(path: Path | None, value: Any) -> bool:
    """Writes `value` where `--json` asks for it; True where that is stdout ("-") and nothing else should be printed.

    UserError where it cannot be written.
    """
    text = json.dumps(value, indent=2)
    if path == STDOUT:
        print(text)
        return True
    write_result(path, text + "\n")
    return False


def write_result(path: Path | None, content: bytes | str | Iterable[bytes]) -> None:
    """Writes the file that an option names, if it does, in one step, and makes its folder. UserError where it cannot."""
    if path is not None:
        with writing_to(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_file(path, content)


def _try_file(path: Path) -> None:
    if is_stream(path):
        if not os.access(path, os.W_OK):  # opened only once: the reader of a pipe would take it for the end
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    elif path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    elif path.parent.is_dir():
        with reserved(path.resolve()):  # by the name that it will have
            pass
    else:
        try_folder(path.parent)


@contextlib.contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """What the `with` block cannot write to `path` is a UserError that says why."""
    try:
        yield
    except OSError as error:
        words, remedy = not_written(error)
        raise UserError(f"cannot be written: {words}", where=path, remedy=remedy) from error
