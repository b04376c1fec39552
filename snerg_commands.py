"""Where the console scripts begin. Nothing is imported here, so that Ctrl-C while all else is being imported is one line, too.

Python itself answers Ctrl-C with a traceback; console.run_command, which does not, takes a moment to arrive.
"""

import sys
from functools import partial
from importlib import import_module

INTERRUPTED = 130
MODULES = {
    "snerg-make": "baker.commands.make",
    "snerg-train": "training.commands.train",
    "snerg-bake": "baker.commands.bake",
    "snerg-eval": "baker.commands.evaluate",
    "snerg-render": "viewer.commands.render",
    "snerg-bench": "viewer.commands.bench",
    "snerg-view": "viewer.commands.view",
    "snerg-pack": "baker.commands.pack",
    "snerg-report": "baker.commands.report",
}


def run(command: str) -> int:
    """Runs one of MODULES; returns its exit status."""
    try:
        import_module("console.streams").open_closed_streams()  # before any file gets the number of one of them
        main = import_module(MODULES[command]).main
    except KeyboardInterrupt:
        print(f"{command}: interrupted", file=sys.stderr)
        return INTERRUPTED
    return main()


make, train, bake, evaluate, render, bench, view, pack, report = (partial(run, command) for command in MODULES)
