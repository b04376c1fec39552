"""`python -m tests.list_options MODULE …`: which options the commands of these modules take, as JSON on stdout.

{"snerg-bake": {"--resolution": {"default": "512", "choices": []}, …}, "snerg-pack info": …}. The
modules are run as programs, but their commands are caught, and asked for their --help in this one process.
"""

import contextlib
import io
import json
import os
import re
import runpy
import sys
import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import console
from snerg_commands import MODULES

Options = dict[str, dict[str, Any]]
run_command = console.run_command
OPTION = re.compile(r"(?:-\w, )?(--[a-z][\w.-]*)(.*)")


def options_of(command: Any, prog: str) -> Options:
    """The options in the --help of a command. default: None where it names none, or the option is required."""
    page = io.StringIO()
    with contextlib.redirect_stdout(page):
        assert run_command(command, prog=prog, args=["--help"]) == 0, prog
    texts: dict[str, str] = {}
    name = ""
    for line in page.getvalue().splitlines():
        row = line.strip("│ ")
        if start := OPTION.fullmatch(row):
            name = start[1]
        if name:
            texts[name] = f"{texts.get(name, '')} {row}"
    return {name: _described(text) for name, text in texts.items()}


def _described(text: str) -> dict[str, Any]:
    choices, default = re.search(r"\{([\w, |-]+)\}", text), re.search(r"\(default: ([^)]*)\)", text)
    return {
        "default": default and default[1],
        "choices": re.split("[,|]", choices[1].replace(" ", "")) if choices else [],
    }


def commands_of(modules: list[str]) -> dict[str, Options]:
    """The options of each command that running these modules would start, by its name."""
    options: dict[str, Options] = {}

    def catch(command: Any, *, prog: str, **_: Any) -> int:
        if isinstance(command, Mapping):
            options.update({f"{prog} {word}": options_of(function, prog) for word, function in command.items()})
        else:
            options[prog] = options_of(command, prog)
        return 0

    console.run_command = catch
    os.environ["COLUMNS"] = "100"  # one column
    warnings.simplefilter("ignore", RuntimeWarning)  # runpy's, of modules that others imported before
    for module in modules:
        sys.argv = [module]
        with contextlib.suppress(SystemExit):
            if module in MODULES.values():
                import_module(module).main()
            else:
                runpy.run_module(module, run_name="__main__", alter_sys=True)
    return options


if __name__ == "__main__":
    print(json.dumps(commands_of(sys.argv[1:])))
