"""The frame around every command: arguments in, exit status out (CONTRACT section 4)."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import tyro

from console.errors import UserError

DONE, BUG, USER_CAN_MEND, INTERRUPTED = 0, 1, 2, 130


def run_command(
    command: Callable[..., Any], *, prog: str, description: str | None = None, args: Sequence[str] | None = None
) -> int:
    """Parses `args` (default: sys.argv) into a call of `command`, and turns what it raises into an exit status.

    Returns 0 done, 2 the user can mend it (one line on stderr), 1 a bug (with its traceback), 130 interrupted.
    `--debug` anywhere on the command line shows tracebacks for status 2 as well.
    """
    words = list(sys.argv[1:] if args is None else args)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        result = tyro.cli(command, prog=prog, description=description, args=words, config=(tyro.conf.FlagConversionOff,))
        return int(result or DONE)
    except UserError as error:
        if debug:
            traceback.print_exc()
        print(f"{prog}: {error}", file=sys.stderr)
        return USER_CAN_MEND
    except KeyboardInterrupt as interrupt:
        print(f"{prog}: interrupted{'; ' + str(interrupt) if str(interrupt) else ''}", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our stdout went away, e.g. `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except SystemExit as stop:  # argument errors and --help, from tyro
        return stop.code if isinstance(stop.code, int) else USER_CAN_MEND
    except Exception:
        traceback.print_exc()
        print(f"{prog}: this is a bug in snerg, not in your input; please report the lines above", file=sys.stderr)
        return BUG
